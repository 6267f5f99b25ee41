"""The rig's time for an operator, and marks at it: within the bounds, in the session, for nobody else."""

import asyncio
import time
from pathlib import Path

from capture_app.common.host_clock import host_from_monotonic
from capture_app.rig.rig import AsyncRig
from capture_app.rig.taking import TakePlan
from capture_app.session.format.marks import RIG_MARKS
from capture_app.session.reading.verify import verify
from tests.cheap_rig import rig_of
from tests.waiting import until


async def test_a_mark_is_in_the_take_under_way(tmp_path: Path) -> None:
    async with rig_of(2, tmp_path) as leader, AsyncRig(str(leader.own_address)) as rig:
        await rig.wait_until_ready(2)
        taking = asyncio.ensure_future(rig.take(TakePlan(frames=30, name="run")).result())
        await until(lambda: leader.bursts.newest is not None)
        before_ns = time.monotonic_ns()
        placed = await rig.mark("stimulus")
        earlier = await rig.mark("cue", local_ns=before_ns - 50_000_000)
        after_ns = time.monotonic_ns()
        assert placed.sessions == earlier.sessions == ("run-001",)
        session = (await taking).open()
    assert [mark.text for mark in session.marks] == ["cue", "stimulus"]
    cue, stimulus = session.marks
    begun_ns, ended_ns, cue_ns = map(host_from_monotonic, (before_ns, after_ns, before_ns - 50_000_000))
    assert begun_ns - stimulus.uncertainty_ns <= stimulus.leader_ns <= ended_ns + stimulus.uncertainty_ns
    assert abs(cue.leader_ns - cue_ns) <= cue.uncertainty_ns
    assert verify(session) == []
    assert not (tmp_path / RIG_MARKS).exists()
