"""Fixtures for tests of the screen."""

import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
from textual import strip
from textual.css.model import RuleSet
from textual.css.stylesheet import Stylesheet
from textual.notifications import Notification
from textual.widgets import Input

from tests.unit.tui.driving import stand_still


@pytest.fixture(scope="session", autouse=True)
def _style_sheets_are_parsed_once() -> Iterator[None]:
    """Share parsed style sheets among all apps: each would parse the same ones several times."""
    parse, parsed = Stylesheet._parse_rules, dict[Any, list[RuleSet]]()

    def parse_once(sheet: Stylesheet, css: str, *where: Any, **more: Any) -> list[RuleSet]:
        of = (css, where, *sorted(more.items()), *sorted(sheet._variables.items()))
        if of not in parsed:
            parsed[of] = parse(sheet, css, *where, **more)
        return parsed[of]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Stylesheet, "_parse_rules", parse_once)
        yield


class NoCache:
    """Stores nothing."""

    def get(self, key: object, default: object = None) -> object:
        return default

    def __setitem__(self, key: object, value: object) -> None:
        pass


@pytest.fixture(scope="session", autouse=True)
def _strips_share_a_cache() -> Iterator[None]:
    """Give each line of a screen no caches of its own: to make seven costs more than a test gains."""
    none = NoCache()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(strip, "FIFOCache", lambda _: none)
        yield


@pytest.fixture(autouse=True)
def _toasts_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Show toasts until the test ends, however long a busy machine takes to look at them."""
    monkeypatch.setattr(Notification, "time_left", 3600.0)
    monkeypatch.setattr(Notification, "has_expired", False)


@pytest.fixture
def snap_compare(snap_compare: Callable[..., bool], monkeypatch: pytest.MonkeyPatch) -> Callable[..., bool]:
    """The plugin's, but a starved machine's screen is compared once it stands still, and no cursor blinks."""
    monkeypatch.setattr(Input, "cursor_blink", False)

    def compare(app: Any, *, run_before: Callable[[Any], Awaitable[object]], **more: Any) -> bool:
        async def before(pilot: Any) -> None:
            await run_before(pilot)
            await stand_still(pilot)

        return snap_compare(app, run_before=before, **more)

    return compare


@pytest.fixture
def utc(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The clock on the wall shows UTC."""
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()
