"""The bundled sessions on the screen: each opens, and a real job of one goes from its key to its picture."""

from pathlib import Path

from capture_app.tui.jobs.result_screen import ResultScreen
from capture_app.tui.jobs.run import STUDIES, RunState
from capture_app.tui.widgets.look import LookScreen
from capture_app.tui.widgets.picture import Picture
from tests.project import SAMPLES
from tests.unit.tui.driving import settle, until
from tests.unit.tui.library.screen import library, looks, rows, view

NAMES = sorted(path.parent.name for path in SAMPLES.glob("*/session.json"))


async def test_each_opens(sessions: Path) -> None:
    async with library(sessions) as pilot:
        listed = {Path(key).name: key for key in rows(pilot.app).keys if "sample_sessions" in key}
        assert sorted(listed) == NAMES
        for name in NAMES:
            rows(pilot.app).choose(listed[name])
            await settle(pilot)
            assert view(pilot.app).entry.card.name == name
            await pilot.press("enter")
            await until(pilot, lambda: looks(pilot.app))
            await pilot.press("enter")
            await until(pilot, lambda: isinstance(pilot.app.screen, LookScreen))
            assert pilot.app.screen.shown[1] == 0
            await until(pilot, lambda: pilot.app.screen.query_one(Picture).cells is not None)
            await pilot.press("escape", "escape")
            await until(pilot, lambda: not looks(pilot.app))


async def test_a_panorama_from_the_key_to_its_picture(sessions: Path) -> None:
    async with library(sessions) as pilot:
        key = next(key for key in rows(pilot.app).keys if key.endswith("sample_sessions/crossing"))
        rows(pilot.app).choose(key)
        await settle(pilot)
        await pilot.press(
            "A", *["down"] * [study.name for study in STUDIES].index("panorama"), "enter", "enter"
        )
        await until(pilot, lambda: pilot.app.runs.all and pilot.app.runs.all[0].state.is_over)
        (job,) = pilot.app.runs.all
        assert (job.state, job.kind) == (RunState.DONE, "panorama"), job.message
        # A sample's own folder may be read-only: results lie beside the user's sessions.
        assert job.out == sessions / "_results" / "_sample_sessions" / "crossing" / "panorama"
        await pilot.press("R")
        await until(pilot, lambda: isinstance(pilot.app.screen, ResultScreen))
        picture = pilot.app.screen.query_one(Picture)
        await until(pilot, lambda: picture.cells is not None)
