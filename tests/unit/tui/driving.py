"""What tests of the screen share: the app on a fake rig, and what it shows."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

from textual.app import App
from textual.pilot import Pilot
from textual.widgets._toast import Toast

from capture_app.tui.app import SimulshotApp
from capture_app.tui.rig_record import RigRecord
from capture_app.tui.screen_settings import Settings
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.row_list import RowList
from tests.unit.tui.fake_rig import FakeRig
from tests.waiting import TIMEOUT_S, looked_at, time_limit

Shown = TypeVar("Shown")


def make_app(rig: FakeRig, **different: Any) -> SimulshotApp:
    """The app on this rig, its clock at rest, without a config folder."""
    plain: dict[str, Any] = {
        "settings": Settings(),
        "sessions": Path("sessions"),
        "record": RigRecord(lambda: 100.0),
    }
    return SimulshotApp(rig, **plain | different)


async def settle(pilot: Any) -> None:
    """Let messages of messages come through."""
    for _ in range(4):
        await pilot.pause()


async def finish_work(pilot: Pilot[Any]) -> None:
    """Let what works in threads end, and what it sends come through."""
    await pilot.pause()
    await pilot.app.workers.wait_for_complete()
    await pilot.pause()


@asynccontextmanager
async def running(app: SimulshotApp, width: int = 80, height: int = 24) -> AsyncIterator[Pilot[None]]:
    """Run an app, begin when its first messages have come through, and give its pilot."""
    async with app.run_test(size=(width, height)) as pilot:
        await settle(pilot)
        yield pilot


async def stand_still(pilot: Any) -> None:
    """Wait until the screen changes no more."""
    async with time_limit("a screen that stands still"):
        shown = None
        # Its strips: a screenshot as SVG takes ten times as long to draw.
        while shown != (shown := pilot.app.screen._compositor.render_strips()):
            await asyncio.sleep(0.05)
            await settle(pilot)


async def until(pilot: Any, true: Callable[[], object], seconds: float = TIMEOUT_S) -> None:
    """Wait for what threads and other processes do, with all messages come through."""
    async with time_limit(looked_at(true), seconds):
        await settle(pilot)
        while not true():
            await asyncio.sleep(0.01)
            await settle(pilot)


def screen_of(app: App[None], kind: type[Shown]) -> Shown:
    """The present screen, which is of that kind."""
    screen: Any = app.screen
    assert isinstance(screen, kind)
    return screen


def lines(app: SimulshotApp, selector: str) -> tuple[str, ...]:
    """What a widget of lines on the present screen, or a list with all of its rows, says."""
    widget = app.screen.query_one(selector)
    if isinstance(widget, RowList):
        return tuple(strip.text.rstrip() for key in widget.keys for strip in widget._lines(key))
    assert isinstance(widget, Lines)
    return widget.plain


def text(app: SimulshotApp, selector: str) -> str:
    """The same in one piece."""
    return "\n".join(lines(app, selector))


def toasts(app: SimulshotApp) -> list[str]:
    """The notifications that are shown; the app runs with notifications=True."""
    return [str(toast.render()) for toast in app.screen.query(Toast)]
