"""The depth that is made after a take: what the panel says, its page, and takes that follow quickly."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.tui.jobs import run
from capture_app.tui.jobs.run import MOMENT, Run, RunState
from capture_app.tui.shoot import take_depth
from capture_app.tui.widgets.key_footer import KeyFooter
from tests.unit.tui.driving import make_app, until
from tests.unit.tui.shoot.studio import Studio, ready_rig, saves_into

CHILD = """
import json, shutil, sys, time
from pathlib import Path
words = sys.argv[1:]
how = Path(__file__).with_name("how")
picture = how.with_name("picture.png")
while how.read_text() == "wait":
    time.sleep(0.01)
if how.read_text() == "refuse":
    print("child: error: no valid calibration of this rig is known", file=sys.stderr)
    sys.exit(3)
out = Path(words[words.index("--out") + 1])
if how.read_text() == "pair":
    out.mkdir()
    shutil.copy(picture, out / "pair.png")
    while how.read_text() == "pair":
        time.sleep(0.01)
(out / "depth").mkdir(parents=True)
shutil.copy(picture, out / "depth" / "cam01.png")
views = [{"camera": "cam01", "picture": "depth/cam01.png", "coverage": 0.9}]
found = {"views": views, "reference": "cam01", "fused_points": 12345, "moving_measured": 0.94}
(out / "multiview.json").write_text(json.dumps(found))
(out / "report.html").write_text("to be turned")
print("1 depth map, 12,345 points in 0.1 s; 94 % of moving pixels have depth")
"""


@pytest.fixture
def studio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Studio:
    """A screen that makes depth after takes, by a program that stands in for `reconstruct multiview`."""
    (tmp_path / "depth_of_a_take.py").write_text(CHILD)
    cv2.imwrite(str(tmp_path / "picture.png"), np.full((48, 64, 3), 200, np.uint8))
    (tmp_path / "how").write_text("")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{Path.cwd()}")
    quick = replace(MOMENT, module="depth_of_a_take")
    monkeypatch.setattr(take_depth, "MOMENT", quick)
    monkeypatch.setitem(run.COMMANDS, quick.name, quick)
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path / "sessions")
    made = Studio(rig, tmp_path / "sessions")
    made.app = make_app(rig, sessions=tmp_path / "sessions", depth=True)
    return made


async def test_the_depth_of_two_cameras_is_shown_before_that_of_all(studio: Studio, tmp_path: Path) -> None:
    (tmp_path / "how").write_text("pair")
    async with studio.running(120, 50) as pilot:
        await pilot.press("space")
        depth = studio.view.take_panel.query_one("#takes-depth")
        await until(pilot, lambda: depth.display)
        (run,) = studio.app.runs.all
        assert run.state is RunState.RUNNING
        assert not studio.view.check_action("open_depth", ())
        assert (
            take_depth.picture(studio.app.runs, studio.view.takes[-1].sheet)
            == (run.out / "pair.png").read_bytes()
        )
        (tmp_path / "how").write_text("")
        await until(pilot, lambda: "94 % of moving pixels have depth" in studio.view.take_panel.plain)
        assert take_depth.picture(studio.app.runs, studio.view.takes[-1].sheet) is not None
        assert studio.view.check_action("open_depth", ())
        await until(pilot, lambda: "Depth" in pilot.app.screen.query_one(KeyFooter).plain[0])


async def test_a_depth_that_waits_is_cancelled_for_that_of_the_next_take(
    studio: Studio, tmp_path: Path
) -> None:
    (tmp_path / "how").write_text("wait")
    async with studio.running(120, 50) as pilot:
        for taken in (1, 2, 3):
            await pilot.press("space")
            await until(pilot, lambda: len(studio.app.runs.all) == taken)  # noqa: B023 - awaited here
        states = [run.state for run in sorted(studio.app.runs.all, key=lambda run: run.session)]
        assert states == [RunState.RUNNING, RunState.CANCELLED, RunState.WAITING]


async def test_a_depth_that_does_not_apply_is_forgotten_at_the_next_take(
    studio: Studio, tmp_path: Path
) -> None:
    (tmp_path / "how").write_text("refuse")
    async with studio.running(120, 50) as pilot:
        await pilot.press("space")
        await until(pilot, lambda: [run.state for run in studio.app.runs.all] == [RunState.NOT_APPLICABLE])
        (first,) = studio.app.runs.all
        await pilot.press("space")
        await until(pilot, lambda: any(run is not first for run in studio.app.runs.all))
        assert first not in studio.app.runs.all


async def test_depth_is_not_made_where_it_is_not_wanted(tmp_path: Path) -> None:
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path)
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 50) as pilot:
        await pilot.press("space")
        await until(pilot, lambda: studio.view.takes and studio.view.takes[-1].sheet is not None)
        await studio.settle(pilot)
        assert studio.app.runs.all == []


@pytest.mark.parametrize(("waited_s", "worked_s", "made"), [(900.0, 20.0, True), (70.0, 10_000.0, False)])
async def test_a_machine_that_has_not_the_power_makes_none_by_itself_and_says_so(
    studio: Studio, tmp_path: Path, waited_s: float, worked_s: float, made: bool
) -> None:
    """One that others keep busy has it: what counts is how long its own processors would work."""
    before = Run(kind=MOMENT.name, session=tmp_path / "before", state=RunState.DONE)
    before.seconds, before.processor_s = waited_s, worked_s
    async with studio.running(120, 50) as pilot:
        await until(pilot, lambda: not any(one.group == "jobs" for one in studio.app.workers))
        studio.app.runs.all.append(before)
        await pilot.press("space")
        said = "of moving pixels have depth" if made else "no automatic depth"
        await until(pilot, lambda: said in studio.view.take_panel.plain)
        assert len(studio.app.runs.all) == 1 + made
