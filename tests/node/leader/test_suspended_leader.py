"""A recording during which the leader's machine was suspended: what its session says of the times."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner

from capture_app.cameras.specs import open_camera
from capture_app.cli import app
from capture_app.common.clock import HostClock
from capture_app.common.node_state import NodeState
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.messages import BurstRequest
from capture_app.rig.rig_link import RigLink
from capture_app.session.reading.array_access import OpenSession, open_session
from capture_app.session.reading.verify import verify
from tests.waiting import until

pytestmark = pytest.mark.virtual
S = 1_000_000_000
SLEPT_NS = 400_000_000
NAMES = ("cam0", "cam1")


@dataclass
class SuspendedClock:
    """The host's clock, less the time for which it was suspended."""

    slept_ns: int = 0
    own: HostClock = field(default_factory=HostClock)

    def now_ns(self) -> int:
        return self.own.now_ns() - self.slept_ns

    def local_from_true(self, true_ns: int) -> int:
        return self.own.local_from_true(true_ns) - self.slept_ns

    def true_from_local(self, local_ns: int) -> int:
        return self.own.true_from_local(local_ns + self.slept_ns)


@pytest.fixture
def clock() -> SuspendedClock:
    return SuspendedClock()


@pytest.fixture
async def leader(tmp_path: Path, clock: SuspendedClock) -> AsyncIterator[LeaderNode]:
    options = LeaderOptions(sessions=tmp_path / "sessions", host="127.0.0.1", port=0, clock=clock)
    async with await LeaderNode.start(options) as leader:
        nodes = [
            CameraNode(
                NodeOptions(
                    name=name,
                    open_camera=partial(
                        open_camera, "sim:perfect,scale=0.1,drops=0", clock=HostClock(), name=name
                    ),
                    leaders=(leader.own_address,),
                )
            )
            for name in NAMES
        ]
        running = [asyncio.create_task(node.run()) for node in nodes]
        await until(lambda: [node.state for node in leader.status().nodes] == [NodeState.READY] * len(NAMES))
        yield leader
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)


async def take(leader: LeaderNode, request: BurstRequest) -> OpenSession:
    statuses = [status async for status in RigLink(leader.own_address).burst(request)]
    assert statuses[-1].session is not None
    return open_session(statuses[-1].session)


@pytest.mark.parametrize("request_", [BurstRequest(frames=90, video=True), BurstRequest(frames=90)])
async def test_its_frames_have_wider_bars_and_the_reason(
    leader: LeaderNode, clock: SuspendedClock, request_: BurstRequest
) -> None:
    earlier = await take(leader, BurstRequest(frames=2))
    running = asyncio.create_task(take(leader, request_))
    await asyncio.sleep(2)
    woke_ns = clock.own.now_ns()
    clock.slept_ns = SLEPT_NS
    session = await running
    assert verify(session) == []
    touched = [image for image in session.manifest.images if (image.uncertainty_ns or 0) >= SLEPT_NS]
    assert {image.camera for image in touched} == {*NAMES}
    for image in touched:
        assert image.local_ns is not None
        # A video's frames are timed as they are taken: some, until a few answers of the leader agree.
        assert image.local_ns <= woke_ns + S
        assert not request_.video or image.local_ns >= woke_ns - S
    untouched = [image for image in session.manifest.images if image not in touched]
    assert untouched, "what was taken after it is right"
    assert session.manifest.sync is not None
    assert (session.manifest.sync.uncertainty_ns or 0) >= SLEPT_NS
    assert session.verdict.grade == "poor"
    shown = CliRunner().invoke(app, ["sessions", "show", str(session.folder)]).output
    assert "a clock was changed, which was noticed only afterwards: these times are known to 400 ms" in shown
    assert not any(camera.widened for camera in earlier.manifest.cameras)
