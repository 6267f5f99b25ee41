"""The mode Jobs: what is seen of jobs, and what its keys do."""

import re
import webbrowser
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from msgspec import structs

from capture_app.protocol.status import BurstStatus
from capture_app.tui.jobs.jobs_view import JobsView
from capture_app.tui.jobs.result_screen import ResultScreen
from capture_app.tui.jobs.run import COMMANDS, RunState
from capture_app.tui.key_bindings import known_actions
from capture_app.tui.widgets.key_footer import KeyFooter
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.picture import Picture, SharpTerminal
from capture_app.tui.widgets.row_list import RowList
from tests.unit.tui.driving import make_app, settle, stand_still, toasts, until
from tests.unit.tui.fake_rig import FakeRig
from tests.unit.tui.jobs.found import add_comparison, add_depth, add_dose, add_job, add_panorama
from tests.unit.tui.takes import make_take
from tests.unit.tui.widgets.sent import PLACEHOLDER, Sent

QUICK = replace(COMMANDS["compare"], module="tests.unit.tui.jobs.quick_command", words=("compare",), quick="")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A comparison is quick."""
    monkeypatch.setitem(COMMANDS, QUICK.name, QUICK)


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a take, named as from beside it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    make_take(tmp_path / "sessions", name="take")
    return tmp_path / "sessions"


@asynccontextmanager
async def jobs_mode(root: Path, size: tuple[int, int] = (120, 40), **different: Any) -> AsyncIterator[Any]:
    """A pilot of the app in the mode Jobs; its rig is `pilot.rig`."""
    rig = FakeRig(1)
    app = make_app(rig, sessions=root, **different)
    async with app.run_test(size=size, notifications=True) as pilot:
        pilot.rig = rig  # type: ignore[attr-defined]
        await pilot.press("4")
        await settle(pilot)
        yield pilot


def view(pilot: Any) -> JobsView:
    return pilot.app.screen_stack[0].query_one(JobsView)


def text(pilot: Any) -> str:
    listed = view(pilot).query_one(RowList)
    return "\n".join(listed.render_line(y).text.rstrip() for y in range(listed.size.height))


def log(pilot: Any) -> str:
    return "\n".join(view(pilot).query_one("#job-lines", Lines).plain)


async def test_without_a_job_it_names_keys_that_start_one(root: Path) -> None:
    async with jobs_mode(root) as pilot:
        hint = view(pilot).query_one("#jobs-empty", Lines).plain[-1]
        named = re.findall(r"\b(\w) (?:compares|exports|starts)", hint)
        actions = ("compare", "export", "analyse")
        assert named == [known_actions()[f"sessions.{action}"].key for action in actions]


async def test_jobs_of_earlier_runs_are_there(root: Path) -> None:
    add_comparison(root, "take")
    add_job(root, "tolerance", "take", RunState.FAILED, "the burst has one instant only")
    async with jobs_mode(root) as pilot:
        await until(pilot, lambda: "✖ failed" in text(pilot))
        assert "✔ done" in text(pilot)
        assert "the right distance is found for 97 %" in text(pilot)
        await until(pilot, lambda: "$ reconstruct tolerance" in log(pilot))
        assert "the burst has one instant only" in log(pilot)


@pytest.mark.usefixtures("quick")
async def test_a_running_job_is_followed_cancelled_and_run_again(root: Path, tmp_path: Path) -> None:
    async with jobs_mode(root) as pilot:
        go = tmp_path / "go"
        job = pilot.app.runs.add(QUICK, root / "take", f"say '[3/4] stereo [b]cam00[/b]' wait {go}")
        await until(pilot, lambda: "50 %" in text(pilot))
        assert "stereo [b]cam00[/b]" in text(pilot)
        assert "▶ running" in text(pilot)
        assert "[3/4] stereo [b]cam00[/b]" in log(pilot)
        await pilot.press("x")
        await until(pilot, lambda: "◌ cancelled" in text(pilot))
        assert job.state is RunState.CANCELLED
        go.touch()
        await pilot.press("r")
        await until(pilot, lambda: "✔ done" in text(pilot))
        await pilot.press("delete")
        await until(pilot, lambda: not pilot.app.runs.all)


@pytest.mark.usefixtures("quick")
async def test_the_list_has_the_focus_though_it_filled_just_before(root: Path) -> None:
    async with jobs_mode(root) as pilot:
        pilot.app.screen.set_focus(None)
        view(pilot).on_mode_shown()
        pilot.app.runs.add(QUICK, root / "take", "")
        await settle(pilot)
        assert view(pilot).query_one(RowList).has_focus


@pytest.mark.usefixtures("quick")
async def test_the_end_of_a_job_is_told_in_every_mode(root: Path) -> None:
    async with jobs_mode(root) as pilot:
        await pilot.press("1")
        pilot.app.runs.add(QUICK, root / "take", "")
        await until(pilot, lambda: any("Compare of take is done" in toast for toast in toasts(pilot.app)))
        pilot.app.runs.add(QUICK, root / "take", "fail")
        await until(pilot, lambda: any("one instant only" in toast for toast in toasts(pilot.app)))
        # What the run before has found is still there.
        assert pilot.app.runs.all[0].result is not None


@pytest.mark.usefixtures("quick")
async def test_jobs_stand_still_while_a_burst_is_taken(root: Path, tmp_path: Path) -> None:
    async with jobs_mode(root) as pilot:
        pilot.app.runs.add(QUICK, root / "take", f"say '[1/2] begun' wait {tmp_path / 'go'}")
        await until(pilot, lambda: "begun" in text(pilot))
        burst = BurstStatus(burst=1, name="b", cameras=1, instants=5, received=0, expected=5)
        pilot.rig.burst_status = burst
        pilot.rig.tell()
        await until(pilot, lambda: "⏸ paused" in text(pilot))
        pilot.rig.burst_status = structs.replace(burst, done=True)
        pilot.rig.tell()
        await until(pilot, lambda: "▶ running" in text(pilot))
        (tmp_path / "go").touch()
        await until(pilot, lambda: "✔ done" in text(pilot))


async def test_a_result_is_sharp_unless_it_blinks(root: Path) -> None:
    add_comparison(root, "take")
    async with jobs_mode(root, sharp_terminal=SharpTerminal(Sent, (10, 20))) as pilot:
        await until(pilot, lambda: "✔ done" in text(pilot))
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, ResultScreen))
        screen, picture = pilot.app.screen, pilot.app.screen.query_one(Picture)

        def sharp() -> bool:
            return PLACEHOLDER in picture.render_line(picture.size.height // 2).text

        await until(pilot, sharp)
        await pilot.press("space")
        assert screen.shows_offset
        await until(pilot, sharp)
        await pilot.press("b")
        await until(pilot, lambda: not screen.shows_offset and not sharp())
        for worker in [worker for worker in pilot.app.workers if worker.node is picture]:
            await worker.wait()
        assert not sharp()
        await pilot.press("b")
        await until(pilot, sharp)


async def test_the_report_opens_in_the_browser_and_over_ssh_its_path_is_told(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = add_comparison(root, "take")
    assert job.out is not None
    report = job.out / "report.html"
    opened: list[str] = []
    async with jobs_mode(root) as pilot:
        monkeypatch.setattr(pilot.app, "open_url", opened.append)
        monkeypatch.setattr("webbrowser.get", lambda: None)
        monkeypatch.delenv("SSH_CONNECTION", raising=False)
        monkeypatch.delenv("SSH_TTY", raising=False)
        await until(pilot, lambda: "✔ done" in text(pilot))
        await pilot.press("o")
        await until(pilot, lambda: opened)
        assert opened == [report.as_uri()]
        monkeypatch.setattr("webbrowser.get", Mock(side_effect=webbrowser.Error("no runnable browser")))
        await pilot.press("o")
        await until(pilot, lambda: any("is on this machine" in toast for toast in toasts(pilot.app)))
        assert len(opened) == 1
        monkeypatch.setenv("SSH_CONNECTION", "1.2.3.4 5 6.7.8.9 22")
        await pilot.press("o")
        await until(pilot, lambda: any(str(report) in toast for toast in toasts(pilot.app)))
        assert pilot.app.clipboard == str(report)
        assert len(opened) == 1


@pytest.mark.usefixtures("quick")
async def test_the_footer_offers_what_the_chosen_job_has_whatever_is_focused(
    root: Path, tmp_path: Path
) -> None:
    add_depth(root, "take")
    async with jobs_mode(root) as pilot:
        await until(pilot, lambda: "✔ done" in text(pilot))
        footer = pilot.app.screen.query_one(KeyFooter)
        assert "Results" in footer.plain[0]
        assert "Report" not in footer.plain[0], "depth from all cameras writes none"
        job = pilot.app.runs.add(QUICK, root / "take", f"say begun wait {tmp_path / 'go'}")
        await settle(pilot)
        view(pilot).query_one(RowList).choose(job.key)
        view(pilot).query_one("#job-log").focus()
        await until(pilot, lambda: "Cancel" in footer.plain[0])
        (tmp_path / "go").touch()
        await until(pilot, lambda: "Again" in footer.plain[0])
        assert "Cancel" not in footer.plain[0]
        assert "Results" in footer.plain[0]


async def test_a_picture_of_one_condition_has_no_switch(root: Path) -> None:
    add_depth(root, "take")
    async with jobs_mode(root) as pilot:
        await until(pilot, lambda: "✔ done" in text(pilot))
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, ResultScreen))
        await until(pilot, lambda: pilot.app.screen.query_one(Picture).cells is not None)
        (sides,) = pilot.app.screen.query_one("#result-labels", Lines).plain
        assert sides.split() == ["1/2", "Distance,", "cam00"]


async def test_a_result_that_cannot_be_read_or_is_gone(root: Path) -> None:
    job = add_comparison(root, "take")
    async with jobs_mode(root) as pilot:
        await until(pilot, lambda: "✔ done" in text(pilot))
        assert job.result is not None
        job.result.write_text("{")
        await pilot.press("enter")
        await until(pilot, lambda: any("run it again" in toast for toast in toasts(pilot.app)))
        job.result.unlink()
        assert view(pilot).check_action("on_run", ("open",)) is False


@pytest.mark.usefixtures("utc")
def test_the_list_looks_as_it_did(snap_compare: Any, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(root.parent)
    here = Path("sessions")
    for add in (add_comparison, add_panorama, add_dose, add_depth):
        add(here, "take")
    add_job(here, "verify", "take", RunState.FAILED, "take is damaged: cam00/000001.jpg is missing")
    app = make_app(FakeRig(1), sessions=here)

    async def before(pilot: Any) -> None:
        await pilot.press("4")
        await until(pilot, lambda: "damaged" in text(pilot) and view(pilot).query_one(RowList).has_focus)
        said = view(pilot).query_one("#job-lines", Lines)
        await until(pilot, lambda: said.plain and said.size.height == len(said.plain))
        await stand_still(pilot)

    assert snap_compare(app, terminal_size=(120, 40), run_before=before)


def test_a_result_looks_as_it_did(snap_compare: Any, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(root.parent)
    add_comparison(Path("sessions"), "take")
    app = make_app(FakeRig(1), sessions=Path("sessions"))

    async def before(pilot: Any) -> None:
        await pilot.press("4")
        await until(pilot, lambda: "✔ done" in text(pilot))
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, ResultScreen))
        await pilot.press("space")
        await until(pilot, lambda: pilot.app.screen.query_one(Picture).cells is not None)
        await settle(pilot)

    assert snap_compare(app, terminal_size=(80, 24), run_before=before)
