"""How the mode Sessions looks: three sizes, and other colours."""

from pathlib import Path
from typing import Any

import pytest

from capture_app.session.exporting import exporter
from capture_app.tui import app
from capture_app.tui.app import SimulshotApp
from capture_app.tui.library.sessions_view import SessionsView
from capture_app.tui.screen_settings import Settings
from capture_app.tui.widgets.contact_sheet import ContactSheet
from tests.unit.tui.driving import make_app, settle, until
from tests.unit.tui.fake_rig import FakeRig
from tests.unit.tui.jobs.found import add_comparison, add_job
from tests.unit.tui.library.screen import text, view
from tests.unit.tui.takes import make_take

pytestmark = pytest.mark.usefixtures("utc")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three takes, what was made of one, and an interrupted one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    # Without the bundled samples, whose pictures may be rendered again.
    monkeypatch.setattr(app, "find_samples", lambda _: None)
    # `make readers` installs what an export is for.
    monkeypatch.setattr(exporter, "is_here", lambda module: module != "rerun")
    here = Path("sessions")
    for number, (name, spread_ns, note) in enumerate(
        (
            ("first-jump", 1_400_000, "the dancer left too early"),
            ("second-jump", 40_000, "[b]the one[/b]"),
            ("third-jump", 22_000_000, ""),
        )
    ):
        created = f"2026-01-31T1{number}:00:00.000Z"
        make_take(here, name=name, spread_ns=spread_ns, note=note, cameras=5, instants=4, created=created)
    add_comparison(here, "second-jump")
    add_job(here, "panorama", "first-jump")
    return here


def make(folder: Path, theme: str = "") -> SimulshotApp:
    settings = Settings()
    if theme:
        settings.remember("theme", theme)
    return make_app(FakeRig(1), sessions=folder, settings=settings)


async def ready(pilot: Any) -> None:
    await pilot.press("3")
    await until(pilot, lambda: pilot.app.screen.query(SessionsView) and "★" in text(pilot.app))
    await until(pilot, lambda: "✔ compare" in text(pilot.app))
    await pilot.press("down")
    wide = pilot.app.size.width >= 120
    await until(pilot, lambda: not wide or shown_beside(pilot) == view(pilot.app).entry.card.folder)
    await until(pilot, lambda: all(w.is_finished or w.group == "rig" for w in pilot.app.workers))


def shown_beside(pilot: Any) -> Path | None:
    """The session whose pictures stand beside the list."""
    sheet = view(pilot.app).query_one(ContactSheet).sheet
    return None if sheet is None else sheet.session.folder


def test_without_colours(snap_compare: Any, folder: Path) -> None:
    assert snap_compare(make(folder, "no-colour"), terminal_size=(80, 24), run_before=ready)


def test_a_question_looks_as_it_did(snap_compare: Any, folder: Path) -> None:
    async def before(pilot: Any) -> None:
        await ready(pilot)
        await pilot.press("e")
        await settle(pilot)

    assert snap_compare(make(folder), terminal_size=(80, 24), run_before=before)
