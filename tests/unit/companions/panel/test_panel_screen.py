"""The check with a panel: its page is served while the dialog is open, and not after."""

import asyncio
from functools import partial
from urllib.request import urlopen

from capture_app.companions.panel.screen import page_html
from capture_app.tui.app import SimulshotApp
from capture_app.tui.rig.guide_screens import GuideScreen
from tests.unit.tui.driving import lines, make_app, running, screen_of, settle, text, until
from tests.unit.tui.fake_rig import FakeRig


def fetch(port: int) -> bytes | None:
    try:
        with urlopen(f"http://127.0.0.1:{port}/", timeout=30) as answer:
            return bytes(answer.read())
    except OSError:
        return None


def shows_panel(app: SimulshotApp) -> bool:
    return isinstance(app.screen, GuideScreen)


async def test_the_page_is_served_while_one_looks() -> None:
    app = make_app(FakeRig(5))
    async with running(app) as pilot:
        await pilot.press("p")
        await until(pilot, lambda: isinstance(app.screen, GuideScreen))
        screen = screen_of(app, GuideScreen)
        await until(pilot, lambda: screen.url)
        assert screen.url in text(app, "#panel-words")
        code = lines(app, "#panel-code")
        assert len(code) > 10
        # Words and code fit side by side, frame included.
        assert max(map(len, lines(app, "#panel-words"))) + max(map(len, code)) <= 74
        assert len(code) <= 20
        port = int(screen.url.rstrip("/").rpartition(":")[2])
        assert await asyncio.to_thread(fetch, port) == page_html()
        await pilot.press("escape")
        await until(pilot, lambda: not isinstance(app.screen, GuideScreen))
        async with asyncio.timeout(60):
            while await asyncio.to_thread(fetch, port) is not None:
                await settle(pilot)


async def test_a_second_screen_takes_another_port() -> None:
    one, other = make_app(FakeRig(1)), make_app(FakeRig(1))
    async with one.run_test(size=(80, 24)) as first, other.run_test(size=(80, 24)) as second:
        urls = []
        for app, pilot in ((one, first), (other, second)):
            await settle(pilot)
            await pilot.press("p")
            await until(pilot, partial(shows_panel, app))
            screen = screen_of(app, GuideScreen)
            await until(pilot, partial(getattr, screen, "url"))
            urls.append(screen.url)
        assert urls[0] != urls[1]
