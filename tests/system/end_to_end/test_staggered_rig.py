"""Five processes with simulated cameras and clocks that are hours off, one after the other in 33 ms."""

import asyncio
from itertools import pairwise
from pathlib import Path

import pytest

from capture_app.companions.panel.pattern import nearest_ns
from capture_app.companions.panel.session_times import read_session
from capture_app.session.reading.array_access import open_session
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.conftest import Start
from tests.system.end_to_end.rig import burst, join_ready, lead, output

NAMES = tuple(f"cam{number}" for number in range(5))
PANEL_CAMERA = "sim:phone-a,drops=0,outliers=0,scene=led-panel,exposure_ms=0.1"
HALF = 0.5
"""Fraction of a step by which true times may be off: processes of a busy machine are woken late."""


async def test_the_frames_of_five_processes_follow_each_other(start: Start, tmp_path: Path) -> None:
    _, address = await lead(start, tmp_path / "sessions", options=("--stagger", "even"))
    await join_ready(start, address, *NAMES)
    status = await output(await start("status", "--leader", address))
    assert "stagger: even, steps of 6.67 ms" in status
    done = await burst(start, address, "--frames", "4")
    session = open_session(done["session"])
    assert verify(session) == []
    step_ns = session.manifest.burst.period_ns / len(NAMES)
    frames = session.sequence
    assert [frame.camera for frame in frames] == [*NAMES] * 4
    for before, after in pairwise(frames):
        assert before.true_ns is not None
        assert after.true_ns is not None
        assert after.true_ns - before.true_ns == pytest.approx(step_ns, abs=HALF * step_ns)
    assert session.verdict.headline.startswith("staggered, steps of 6.67 ms")

    await output(await start("rig", "stagger", "off", "--leader", address))
    done = await burst(start, address, "--frames", "1")
    assert not open_session(done["session"]).is_staggered


async def test_the_panel_shows_the_steps_of_five_processes(start: Start, tmp_path: Path) -> None:
    """Their light, not their timestamps: each reads a panel of LEDs, whose time is the host's."""
    _, address = await lead(start, tmp_path / "sessions", options=("--stagger", "even"))
    nodes = [
        await start("node", "--name", name, "--camera", PANEL_CAMERA, "--clock", "sim", "--leader", address)
        for name in NAMES
    ]
    await asyncio.gather(*(node.says("ready") for node in nodes))
    done = await burst(start, address, "--frames", "3")
    times = read_session(Session.open(Path(done["session"])))
    assert not times.refusals
    panel_ns = {(one.image.camera, one.image.instant): one.panel_ns for one in times.pictures}
    step_ns = open_session(done["session"]).manifest.burst.period_ns / len(NAMES)
    for (camera, instant), at_ns in panel_ns.items():
        due_ns = NAMES.index(camera) * step_ns
        off_ns = nearest_ns(at_ns - panel_ns[NAMES[0], instant] - due_ns, times.panel.cycle_ns)
        assert abs(off_ns) < HALF * step_ns
