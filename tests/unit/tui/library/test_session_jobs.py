"""Jobs that are started from the list of sessions: their forms, and what they leave."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from textual.containers import VerticalScroll
from textual.widgets import Input, OptionList, Static

from capture_app.session.exporting import exporter
from capture_app.tui.jobs.run import COMMANDS, COVERAGE, IMPORT, STUDIES
from capture_app.tui.library import sessions_view
from capture_app.tui.question import Question, TextQuestion
from reconstruction.commands.calibrate import calibrate
from tests.unit.tui.driving import settle, toasts, until
from tests.unit.tui.library.screen import choose, library, text, type_text

NO_PATHS = ("~nobody-of-this-name/films", "x" * 300)


def jobs(pilot: Any) -> list[Any]:
    return list(pilot.app.runs.all)


async def test_no_explanation_is_cut_at_80_columns(sessions: Path) -> None:
    async with library(sessions, (80, 24)) as pilot:
        await choose(pilot, "one")
        for key in ("A", "e"):
            await pilot.press(key)
            await until(pilot, lambda: pilot.app.screen.query(OptionList))
            options = pilot.app.screen.query_one(OptionList)
            width = options.scrollable_content_region.width
            assert all(option.prompt.cell_length <= width - 2 for option in options.options)
            assert options.max_scroll_y == 0, "no format is out of sight"
            await pilot.press("escape")
            await until(pilot, lambda: not pilot.app.screen.query(OptionList))


async def test_how_far_a_job_is_is_told_beside_its_session_at_once(
    sessions: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture_app.tui.library.sessions_view.LOOK_AGAIN_S", 3600.0)
    quick = replace(COMMANDS["compare"], module="tests.unit.tui.jobs.quick_command")
    monkeypatch.setitem(COMMANDS, quick.name, quick)
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        going = pilot.app.runs.add(
            quick, sessions / "one", f"wait {tmp_path / 'go'} say '[3/5] depth' wait {tmp_path / 'never'}"
        )
        await until(pilot, lambda: "▶ compare" in text(pilot.app))
        (tmp_path / "go").touch()
        await until(pilot, lambda: "▶ compare 40 %" in text(pilot.app))
        await pilot.app.runs.cancel(going)


async def test_a_path_that_none_can_be_is_no_folder_and_no_error(sessions: Path) -> None:
    async with library(sessions) as pilot:
        await pilot.press("I")
        await settle(pilot)
        line = pilot.app.screen.query_one(Input)
        line.focus()
        for typed in NO_PATHS:
            await type_text(pilot, typed)
            assert line.value == typed
            wrong = pilot.app.screen.query_one(".wrong", Static)
            assert "this folder does not exist" in str(wrong.content)
        await pilot.press("escape")
        await settle(pilot)
        assert not jobs(pilot)


async def test_an_analysis_asks_what_matters_and_opens_its_page(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path | None] = []
    monkeypatch.setattr(sessions_view, "open_report", lambda _, page: opened.append(page))
    quick = replace(
        COMMANDS["splat"],
        module="tests.unit.tui.jobs.quick_command",
        choices=(("quick", "write splat.json"), ("with its page", "write splat.json write splat.html")),
        fixed=(),
    )
    monkeypatch.setitem(COMMANDS, quick.name, quick)
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("A", *["down"] * [study.name for study in STUDIES].index("splat"), "enter")
        await settle(pilot)
        assert "with its page" in str(pilot.app.screen.query_one(OptionList).get_option_at_index(1).prompt)
        await pilot.press("down", "enter")
        await settle(pilot)
        assert pilot.app.screen.query_one(Input).value == "write splat.json write splat.html"
        await pilot.press("enter")
        await until(pilot, lambda: opened)
        (job,) = jobs(pilot)
        assert opened == [job.out / "splat.html"]


@pytest.mark.parametrize(
    "entry", [place for place, (_, line) in enumerate(COMMANDS["calibrate"].choices) if line != COVERAGE]
)
@pytest.mark.parametrize(("key", "options"), [("r", ["--replace"]), ("k", None)])
async def test_a_calibration_that_is_there_is_a_question(
    sessions: Path, monkeypatch: pytest.MonkeyPatch, entry: int, key: str, options: list[str] | None
) -> None:
    (sessions / "one" / "calibration.json").write_text("{}")
    quick = replace(COMMANDS["calibrate"], module="tests.unit.tui.jobs.quick_command", words=())
    monkeypatch.setitem(COMMANDS, quick.name, quick)
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("A", *["down"] * [study.name for study in STUDIES].index("calibrate"), "enter")
        await settle(pilot)
        await pilot.press(*["down"] * entry, "enter")
        await settle(pilot)
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, Question))
        await pilot.press(key)
        await settle(pilot)
        assert [job.options.split()[-1:] for job in jobs(pilot)] == ([] if options is None else [options])


def says(pilot: Any, count: int) -> bool:
    """Whether so many notifications are shown."""
    return len(toasts(pilot.app)) == count


async def test_all_that_an_export_needs_is_said_at_once_and_before_its_folder(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporter, "is_here", lambda module: module != "av")
    (sessions / "two" / "calibration.json").write_text("{}")
    async with library(sessions, (80, 24)) as pilot:
        needs = ("one", "needs packages and a calibration"), ("two", "needs packages")
        for count, (name, row) in enumerate(needs, 1):
            await choose(pilot, name)
            await pilot.press("e")
            await until(pilot, lambda: pilot.app.screen.query(OptionList))
            formats = pilot.app.screen.query_one(OptionList)
            place = formats.get_option_index("pose2sim")
            assert str(formats.get_option_at_index(place).prompt).endswith(f"  {row}")
            formats.highlighted = place
            await pilot.press("enter")
            await until(pilot, partial(says, pilot, count))
            assert not isinstance(pilot.app.screen, TextQuestion)
            said = toasts(pilot.app)[-1]
            assert said.startswith("An export to pose2sim needs\npackages: ")
            assert ("\na calibration: reconstruct calibrate makes one" in said) == (name == "one")
        await pilot.press("e")
        await until(pilot, lambda: pilot.app.screen.query(OptionList))
        pilot.app.screen.query_one(OptionList).highlighted = formats.get_option_index("nerfstudio")
        await pilot.press("enter")
        # Nothing is missing.
        await until(pilot, lambda: isinstance(pilot.app.screen, TextQuestion))


def test_the_options_of_a_board_are_those_that_the_command_takes_by_itself() -> None:
    (options,) = (line for _, line in COMMANDS["calibrate"].choices if line.startswith("--from board"))
    said = {param.opts[0]: param.default for param in calibrate.params}
    assert said["--square-mm"] == 35.0
    assert options == f"--from board --board {said['--board']} --square-mm {said['--square-mm']:g}"


async def test_numbered_pictures_are_imported_with_the_options_that_are_asked_for(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = replace(IMPORT, module="tests.unit.tui.jobs.quick_command", words=())
    monkeypatch.setattr(sessions_view, "IMPORT", quick)
    monkeypatch.setitem(COMMANDS, quick.name, quick)
    async with library(sessions) as pilot:
        await pilot.press("I")
        await settle(pilot)
        await type_text(pilot, str(sessions))
        await pilot.press("enter")
        await settle(pilot)
        assert "Numbered pictures need their --fps" in str(pilot.app.screen.query(Static).first().content)
        await type_text(pilot, "--fps 25")
        await pilot.press("enter")
        await until(pilot, lambda: jobs(pilot))
        (job,) = jobs(pilot)
        assert job.line.endswith(f" {sessions} --fps 25 --out {sessions}")


async def test_the_help_on_its_options_stands_below_the_line_for_them(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = replace(COMMANDS["splat"], module="tests.unit.tui.jobs.quick_command", words=(), choices=())
    monkeypatch.setitem(COMMANDS, quick.name, quick)
    async with library(sessions, (80, 24)) as pilot:
        await choose(pilot, "one")
        await pilot.press("A", *["down"] * [study.name for study in STUDIES].index("splat"), "enter")
        await settle(pilot)
        scroll = pilot.app.screen.query_one(VerticalScroll)
        said = scroll.query_one(Static)
        await until(pilot, lambda: "--pace N" in str(said.content))
        assert "Usage" not in str(said.content)
        assert max(map(len, str(said.content).splitlines())) <= scroll.scrollable_content_region.width
        assert scroll.scroll_y == 0
        await pilot.press("down")
        await until(pilot, lambda: scroll.scroll_y > 0)
        await pilot.press(*"--no")
        assert pilot.app.screen.query_one(Input).value == "--no", "the line keeps the focus"


def test_a_calibration_is_no_question_where_it_is_not_overwritten(sessions: Path) -> None:
    command, folder = COMMANDS["calibrate"], sessions / "one"
    assert not command.would_replace(folder, "--from board")
    (folder / "calibration.json").write_text("{}")
    assert command.would_replace(folder, "--from board")
    for options in ("--from session", "--from board --coverage", "--from sfm --replace"):
        assert not command.would_replace(folder, options)
    assert not COMMANDS["splat"].would_replace(folder, "")
