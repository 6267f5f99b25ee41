"""The page in a real browser with a fake camera: joins by the code, is killed, comes back; what it says."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from tests.browser import CHROMIUM, Browser
from tests.unit.companions.phones.places import Place, serving
from tests.waiting import TIMEOUT_S

pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason="needs a headless Chromium")]

CAMERA = ("--use-fake-device-for-media-stream=fps=15", "--ignore-certificate-errors")
OLD = "delete self.OffscreenCanvas; delete self.WebSocket"


class PhoneBrowser:
    """A browser as large as a phone, whose page is asked in a thread, so that the gateway can answer it."""

    def __init__(self, profile: Path, *flags: str) -> None:
        self._browser = Browser(profile, *CAMERA, *flags)

    async def open(self, url: str, *, before: str = "") -> None:
        await asyncio.to_thread(self._open, url, before)

    async def open_again(self, url: str, *, before: str) -> None:
        await asyncio.to_thread(self._open, url, before, True)

    async def shows(self, words: str) -> None:
        """Wait until the page shows these words."""
        await self.shows_what(lambda text: words in text, repr(words))

    async def shows_what(self, is_it: Callable[[str], object], what: str) -> None:
        """Wait until the page's text is as asked for; a failure says what it is instead."""
        end_s = time.monotonic() + TIMEOUT_S
        while not is_it(text := await self.text()):
            assert time.monotonic() < end_s, f"waited {TIMEOUT_S:g} s for {what}; the page shows {text!r}"
            await asyncio.sleep(0.1)

    async def text(self) -> str:
        return str(await self.ask("document.body.innerText"))

    async def ask(self, expression: str) -> Any:
        return await asyncio.to_thread(self._browser.ask, expression)

    async def hide(self) -> None:
        """Put another tab before the page."""
        await asyncio.to_thread(self._browser.hide)

    async def show(self) -> None:
        await asyncio.to_thread(self._browser.do, "Page.bringToFront")

    def kill(self) -> None:
        self._browser.kill()

    def _open(self, url: str, before: str, again: bool = False) -> None:
        if not again:
            self._browser.start()
        if before:
            self._browser.do("Page.addScriptToEvaluateOnNewDocument", source=before)
        self._browser.open(url, width=390, height=844)


@pytest.fixture
async def place(tmp_path: Path) -> AsyncIterator[Place]:
    async with serving(tmp_path) as place:
        yield place


async def test_what_is_refused_or_lacking_is_said(place: Place, tmp_path: Path) -> None:
    phone = PhoneBrowser(tmp_path / "profile", "--deny-permission-prompts")
    try:
        await phone.open(place.url)
        await phone.ask("document.getElementById('go').click()")
        await phone.shows("The camera was refused")
        await phone.shows("Try again")
        assert place.state("phone") is None
        assert place.url.endswith(place.admission.secret), "a refused camera uses no code up"
        await phone.open_again(place.base, before=OLD)
        await phone.shows("This browser cannot be a camera here")
        text = await phone.text()
        assert "OffscreenCanvas" in text
        assert "WebSockets" in text
        assert "time of each video frame" not in text
    finally:
        phone.kill()
