"""Bursts as operators ask for them: frames of before, names, notes, one after the other."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from capture_app.cameras.specs import open_camera
from capture_app.common.address import Address
from capture_app.common.clock import HostClock
from capture_app.common.errors import BadInputError, NetworkError
from capture_app.common.host_clock import host_ns
from capture_app.common.node_state import NodeState
from capture_app.node.camera import uploader
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.device_profiles import DeviceProfiles, link_key
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.orders import SaveStamp, StampSaved
from capture_app.protocol.status import BurstStatus
from capture_app.rig.rig_link import RigLink, ask_leader
from capture_app.session.format.manifest import EVENTS, Manifest
from capture_app.session.reading.reader import Session
from capture_app.sync.clock.clock_filter import PathAsymmetry
from capture_app.sync.timekeeping.clock_events import TimesDoubted
from tests.cheap_rig import start_leader
from tests.waiting import until

pytestmark = pytest.mark.virtual
TIMEOUT_S = 60.0


@dataclass
class Rig:
    """A leader with one camera that is ready."""

    link: RigLink
    camera: CameraNode


@pytest.fixture
def link(rig: Rig) -> RigLink:
    return rig.link


@asynccontextmanager
async def running_camera(tmp_path: Path, leader: Address) -> AsyncIterator[CameraNode]:
    clock = HostClock()
    options = NodeOptions(
        profiles=DeviceProfiles(tmp_path),
        name="a",
        open_camera=lambda: open_camera("sim:perfect,scale=0.1", clock=clock, name="a"),
        leaders=(leader,),
        clock=clock,
    )
    camera = CameraNode(options)
    running = asyncio.create_task(camera.run())
    yield camera
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def ready(leader: LeaderNode) -> None:
    await until(lambda: [node.state for node in leader.status().nodes] == [NodeState.READY])


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Rig]:
    async with (
        await start_leader(tmp_path / "sessions") as leader,
        running_camera(tmp_path, leader.own_address) as camera,
    ):
        await ready(leader)
        yield Rig(RigLink(leader.own_address), camera)


async def take(link: RigLink, request: BurstRequest) -> BurstStatus:
    async with asyncio.timeout(TIMEOUT_S):
        statuses = [status async for status in link.burst(request)]
    assert statuses[-1].done
    return statuses[-1]


def manifest_of(done: BurstStatus) -> Manifest:
    assert done.session is not None
    return Session.open(Path(done.session)).manifest


async def test_frames_of_before_the_key_are_in_the_take(link: RigLink) -> None:
    began_ns = host_ns()
    done = await take(link, BurstRequest(frames=5, before=3))
    ended_ns = host_ns()
    assert (done.received, done.expected) == (5, 5)
    burst = manifest_of(done).burst
    # The leader's clock is the host's; a grid's instant is at most half a period off what was asked for.
    key_ns = burst.requested_ns + 3 * burst.period_ns
    assert began_ns <= key_ns <= ended_ns
    assert burst.instants_ns[2] < key_ns < burst.instants_ns[4]


async def test_a_take_is_named_and_annotated(link: RigLink) -> None:
    first = await take(link, BurstRequest(frames=1, name="jump", note="without the hat"))
    plain = await take(link, BurstRequest(frames=1))
    again = await take(link, BurstRequest(frames=1, name="jump"))
    assert [done.name for done in (first, plain, again)] == ["jump-001", "burst-001", "jump-002"]
    assert len({done.burst for done in (first, plain, again)}) == 3
    assert manifest_of(first).note == "without the hat"
    assert manifest_of(first).name == "jump-001"
    assert manifest_of(again).note == ""


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        (BurstRequest(frames=2, before=3), "3 of 2 frames"),
        (BurstRequest(frames=2, name="../up"), "not a valid name for a take"),
        (BurstRequest(frames=2, name="x" * 60), "not a valid name for a take"),
    ],
)
async def test_impossible_takes_are_refused(link: RigLink, request_: BurstRequest, says: str) -> None:
    with pytest.raises(BadInputError, match=says):
        await take(link, request_)


async def test_a_node_goes_by_what_was_measured_of_its_link_and_keeps_it(rig: Rig, tmp_path: Path) -> None:
    """Both run on one clock: what the node adds to it is what it was told, as far as its hard bound."""
    link, late_ns = rig.link, 10_000_000_000  # much, so that it counts however long a busy machine takes
    measured = SaveStamp(camera="a", asymmetry=PathAsymmetry(late_ns, 1_000, 100_000))
    assert (await ask_leader(link.leader, measured, StampSaved)).is_stored
    await until(lambda: rig.camera._engine.timekeeper.clock.late_ns == late_ns)
    clock = manifest_of(await take(link, BurstRequest(frames=1))).cameras[0].clock
    assert 0 < clock.offset_ns <= clock.hard_bound_ns
    kept = DeviceProfiles(tmp_path).read(link_key("a", link.leader.host)).asymmetry
    assert kept is not None
    assert kept.late_ns == late_ns


def events_of(done: BurstStatus) -> list[bytes]:
    assert done.session is not None
    return Path(done.session, EVENTS).read_bytes().splitlines()


async def test_what_happened_before_a_take_is_told_with_that_take_alone(rig: Rig) -> None:
    told = []
    for _ in range(2):
        events = events_of(await take(rig.link, BurstRequest(frames=1)))
        told.append({line for line in events if json.loads(line).get("camera") == "a"})
    assert told[0], "its clock was set, at least"
    assert not told[0] & told[1]


@pytest.mark.parametrize("is_before", [True, False])
async def test_frames_of_before_a_step_that_are_picked_after_it_are_doubted(
    rig: Rig, is_before: bool
) -> None:
    until_ns = host_ns() + (10**12 if is_before else -(10**12))
    rig.camera._stepped = TimesDoubted(until_ns - 1, until_ns, 5_000_000, 6_000_000, jumped=True)
    manifest = manifest_of(await take(rig.link, BurstRequest(frames=2)))
    first_ns = min(image.local_ns or 0 for image in manifest.images)
    widened = [
        (times.from_local_ns, times.until_local_ns, times.uncertainty_ns, times.hard_bound_ns)
        for times in manifest.cameras[0].widened
    ]
    assert widened == ([(first_ns, until_ns, 5_000_000, 6_000_000)] if is_before else [])


async def test_the_exchanges_that_a_node_shows_are_those_with_the_leader_it_follows(tmp_path: Path) -> None:
    first = await start_leader(tmp_path / "first")
    async with running_camera(tmp_path, first.own_address) as camera:
        async with first:
            await ready(first)
            earlier = [*camera._samples]
        async with await start_leader(tmp_path / "second", port=first.address.port) as second:
            await ready(second)
            assert earlier
            assert not [sample for sample in camera._samples if sample in earlier]


async def test_a_camera_whose_images_cannot_be_sent_is_named_before_a_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A firewall lets the datagrams of its clock through."""

    async def blocked(*_: Any, **__: Any) -> None:
        raise NetworkError("no machine answers")

    async with await start_leader(tmp_path / "sessions") as leader:
        with monkeypatch.context() as patch:
            patch.setattr(uploader, "connect", blocked)
            async with running_camera(tmp_path, leader.own_address):
                await until(lambda: leader.status().advice.endswith("its images wait: no machine answers"))
                patch.undo()
                await until(lambda: leader.status().advice.startswith("1 camera ready"))
