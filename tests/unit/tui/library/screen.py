"""The mode Sessions on a fake rig, and what it shows."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from textual.widgets import Input

from capture_app.tui.app import SimulshotApp
from capture_app.tui.library.session_rows import SessionRows
from capture_app.tui.library.sessions_view import SessionsView
from tests.unit.tui.driving import make_app, settle, until
from tests.unit.tui.fake_rig import FakeRig


@asynccontextmanager
async def library(sessions: Path, size: tuple[int, int] = (120, 40), **different: Any) -> AsyncIterator[Any]:
    """A pilot of the app in the mode Sessions."""
    app = make_app(FakeRig(1), sessions=sessions, **different)
    async with app.run_test(size=size, notifications=True) as pilot:
        await pilot.press("3")
        await until(pilot, lambda: app.screen.query(SessionRows) and rows(app).keys)
        yield pilot


def view(app: SimulshotApp) -> SessionsView:
    """The mode's view, whatever is pushed on top of it."""
    return app.screen_stack[0].query_one(SessionsView)


def looks(app: SimulshotApp) -> bool:
    """Whether a session is looked at in all of the mode, or one of its pictures."""
    return view(app).has_class("-whole")


def rows(app: SimulshotApp) -> SessionRows:
    return view(app).query_one(SessionRows)


def names(pilot: Any) -> list[str]:
    """The sessions of the folder that are listed, without the samples."""
    return [Path(key).name for key in rows(pilot.app).keys if "sample_sessions" not in key]


def text(app: SimulshotApp) -> str:
    """What the list shows."""
    listed = rows(app)
    return "\n".join(listed.render_line(y).text.rstrip() for y in range(listed.size.height))


async def choose(pilot: Any, name: str) -> None:
    """Put the cursor on a session as a user does."""
    app = pilot.app
    names = [Path(key).name for key in rows(app).keys]
    await pilot.press("home", *["down"] * names.index(name))
    await settle(pilot)
    entry = view(app).entry
    assert entry is not None
    assert entry.card.name == name


async def type_text(pilot: Any, text: str) -> None:
    """Replace what is in the line that has the focus; only the last character is typed."""
    pilot.app.screen.query_one(Input).value = text[:-1]
    await pilot.press("end", text[-1])
    await settle(pilot)
