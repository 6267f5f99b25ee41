"""A recording during which the leader's machine was suspended: what its session says of the times."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

import pytest
from click.testing import CliRunner

from capture_app.cli import app
from capture_app.common.clock import HostClock
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.messages import BurstRequest
from capture_app.session.reading.verify import verify
from capture_app.sync.timekeeping.poll_schedule import SteadySchedule
from tests.cheap_rig import ready_rig, take_session
from tests.virtual.observing import RARE

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


@pytest.fixture(autouse=True)
def rare_requests() -> Iterator[None]:
    """Nodes ask for the time twice a second, as among thousands: a change is noticed after a second."""
    with patch.object(SteadySchedule.__init__, "__kwdefaults__", dict(RARE)):
        yield


@pytest.fixture
async def leader(tmp_path: Path, clock: SuspendedClock) -> AsyncIterator[LeaderNode]:
    options = LeaderOptions(sessions=tmp_path / "sessions", host="127.0.0.1", port=0, clock=clock)
    async with ready_rig(options, NAMES) as leader:
        yield leader


@pytest.mark.parametrize("request_", [BurstRequest(frames=90, video=True), BurstRequest(frames=90)])
async def test_its_frames_have_wider_bars_and_the_reason(
    leader: LeaderNode, clock: SuspendedClock, request_: BurstRequest
) -> None:
    earlier = await take_session(leader, BurstRequest(frames=2))
    running = asyncio.create_task(take_session(leader, request_))
    await asyncio.sleep(2)
    woke_ns = clock.own.now_ns()
    clock.slept_ns = SLEPT_NS
    session = await running
    assert verify(session) == []
    touched = [image for image in session.manifest.images if (image.uncertainty_ns or 0) >= SLEPT_NS]
    assert touched
    assert all(camera.widened for camera in session.manifest.cameras)
    for image in touched:
        assert image.local_ns is not None
        # A video's frames are timed as they are taken: some, until a few answers of the leader agree.
        assert image.local_ns <= woke_ns + 3 * S
        assert not request_.video or image.local_ns >= woke_ns - S
    untouched = [image for image in session.manifest.images if image not in touched]
    assert untouched, "what was taken after it is right"
    assert session.manifest.sync is not None
    assert (session.manifest.sync.uncertainty_ns or 0) >= SLEPT_NS
    assert session.verdict.grade == "poor"
    shown = CliRunner().invoke(app, ["sessions", "show", str(session.folder)]).output
    assert "a clock was changed, which was noticed only afterwards: these times are known to 400 ms" in shown
    assert not any(camera.widened for camera in earlier.manifest.cameras)
