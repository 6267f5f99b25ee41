"""The depth that is made after a take: what the panel says, its page, and takes that follow quickly."""

from functools import partial
from pathlib import Path

import pytest

from capture_app.tui.jobs.run import RunState
from tests.unit.tui.driving import toasts, until
from tests.unit.tui.shoot.studio import Studio
from tests.unit.tui.shoot.test_take_depth import studio  # noqa: F401 - a fixture


async def test_the_panel_shows_depth_after_a_take_and_a_key_opens_its_page(
    studio: Studio, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    monkeypatch.delenv("SSH_TTY", raising=False)
    monkeypatch.setattr(studio.app, "open_url", opened.append)
    monkeypatch.setattr("webbrowser.get", lambda: None)
    async with studio.running(120, 50) as pilot:
        await pilot.press("space")
        await until(pilot, lambda: "94 % of moving pixels have depth" in studio.view.take_panel.plain)
        (made,) = studio.app.runs.all
        assert "--quick" in made.line
        assert f"--instant {studio.view.takes[-1].sheet.instants // 2}" in made.line
        assert studio.view.take_panel.query_one("#takes-depth").display
        await pilot.press("d")
        assert opened == [made.report.resolve().as_uri()]
        # The newest take's depth stays with its lines.
        await pilot.press("space")
        panel = studio.view.take_panel
        await until(pilot, lambda: len(studio.app.runs.all) == 2 and "94 %" in panel.plain)
        depth, earlier = (panel.query_one(f"#takes-{name}") for name in ("depth", "earlier"))
        await until(pilot, lambda: depth.display and earlier.region.y >= depth.region.bottom > 0)
        assert panel.plain.splitlines()[-1].startswith(studio.view.takes[0].status.name)


async def test_a_rig_without_a_calibration_gets_a_line_and_no_alarm(studio: Studio, tmp_path: Path) -> None:
    (tmp_path / "how").write_text("refuse")
    async with studio.running() as pilot:
        said = "depth not applicable: no valid calibration"
        for number in (1, 2):
            await pilot.press("space")
            await until(pilot, partial(has_takes, studio, number))
            await until(pilot, lambda: said in studio.view.take_panel.plain)
            # The sheet of a narrow window hides that pane.
            await until(pilot, lambda: said in str(studio.view.stage.border_subtitle))
        assert not toasts(studio.app)
        assert [job.state for job in studio.app.runs.all] == [RunState.NOT_APPLICABLE], "once, not for each"


async def test_of_takes_that_follow_quickly_the_last_is_not_kept_waiting(
    studio: Studio, tmp_path: Path
) -> None:
    (tmp_path / "how").write_text("wait")
    async with studio.running(120, 50) as pilot:
        for number in (1, 2, 3):
            await pilot.press("space")
            await until(pilot, partial(has_runs, studio, number))
        newest, second, _ = studio.app.runs.all
        assert newest.session.name == studio.view.takes[-1].status.name
        assert second.state is RunState.CANCELLED
        (tmp_path / "how").write_text("")
        await until(pilot, lambda: newest.state is RunState.DONE)


def has_takes(studio: Studio, number: int) -> bool:
    return len(studio.view.takes) == number and studio.view.takes[-1].sheet is not None


def has_runs(studio: Studio, number: int) -> bool:
    return len(studio.app.runs.all) >= number
