"""The monitor in a real browser, as large as a phone and as a tablet: ten cameras, a take, a recording."""

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser import CHROMIUM, Browser
from tests.unit.companions.monitor.served import ServedMonitor, monitored
from tests.waiting import SLOW_PATIENCE_S

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs a headless Chromium")
CAMERAS = 10
PICTURES_PER_S = 2.0
WINDOW_S = 3.0
DRAWN = "[...document.querySelectorAll('.camera')].map(one => Number(one.dataset.pictures || 0))"
SIZES = {"phone": (390, 844), "tablet": (1024, 768)}


class MonitorBrowser:
    """A browser that is asked in a thread, so that the server can answer it."""

    def __init__(self, profile: Path, size: tuple[int, int], *flags: str) -> None:
        self._browser = Browser(profile, "--ignore-certificate-errors", *flags)
        self._size = size

    async def open(self, url: str) -> None:
        def start() -> None:
            self._browser.start()
            self._browser.open(url, width=self._size[0], height=self._size[1])

        await asyncio.to_thread(start)

    async def ask(self, expression: str) -> Any:
        return await asyncio.to_thread(self._browser.ask, expression)

    async def shows(self, condition: str) -> None:
        """Wait until an expression is true; a failure says what the page shows instead."""
        end_s = time.monotonic() + SLOW_PATIENCE_S
        while not await self.ask(condition):
            text = await self.ask("document.body.innerText")
            assert time.monotonic() < end_s, f"waited for {condition}; the page shows {text!r}"
            await asyncio.sleep(0.1)

    async def tap(self, selector: str) -> None:
        await self.ask(f"document.querySelector({selector!r}).click()")

    def drag(self, selector: str, start: float, end: float) -> None:
        """Drag across an element, between these fractions of its width."""
        self._browser.drag(*self._browser.point(selector, start, end))

    async def rates(self) -> list[float]:
        """How many pictures of each camera the page has drawn a second."""
        began_s, before = time.monotonic(), await self.ask(DRAWN)
        await asyncio.sleep(WINDOW_S)
        after = await self.ask(DRAWN)
        took_s = time.monotonic() - began_s
        return [(last - first) / took_s for first, last in zip(before, after, strict=True)]

    def kill(self) -> None:
        self._browser.kill()


@pytest.fixture
async def served(tmp_path: Path) -> AsyncIterator[ServedMonitor]:
    async with monitored(tmp_path, CAMERAS) as served:
        yield served


@pytest.mark.parametrize("device", SIZES)
async def test_ten_cameras_are_live_and_the_button_takes(
    served: ServedMonitor, tmp_path: Path, device: str
) -> None:
    browser = MonitorBrowser(tmp_path / "profile", SIZES[device])
    try:
        await browser.open(await served.url())
        await browser.shows(f"document.querySelectorAll('[data-pictures]').length === {CAMERAS}")
        assert not await browser.ask("location.hash"), "the secret is not left in the address"
        end_s = time.monotonic() + SLOW_PATIENCE_S
        # A starved machine delivers fewer for a while.
        while min(rates := await browser.rates()) < PICTURES_PER_S:
            assert time.monotonic() < end_s, rates
        width = SIZES[device][0]
        assert await browser.ask("document.documentElement.scrollWidth") == width, "nothing is cut off"
        assert await browser.ask(
            "[...document.querySelectorAll('footer button')].filter(one => one.offsetParent)"
            ".map(one => one.getBoundingClientRect())"
            f".every(one => one.height >= 44 && one.left >= 0 && one.right <= {width})"
        ), "each button is large enough for a thumb"
        await browser.shows("document.body.classList.contains('good')")
        await browser.tap("[data-setting=countdown] [value='3']")
        await browser.tap("#shutter")
        await browser.shows("document.querySelector('#shutter span').textContent === '2'")
        # A starved machine may deliver no image of a take, or those of a few cameras, and says so.
        end_s, poor = time.monotonic() + SLOW_PATIENCE_S, ""
        while True:
            await browser.shows(f"course.state === 'failed' || (take && take.name !== '{poor}')")
            if await browser.ask("course.state !== 'failed' && take.grade !== 'poor'"):
                break
            poor = await browser.ask("take ? take.name : ''")
            assert time.monotonic() < end_s, f"{poor} is as poor as those before it"
            await browser.tap("#shutter")
            await browser.shows("course.state !== 'failed'")
        await browser.shows("document.getElementById('picture').naturalWidth > 1000")
        assert await browser.ask("document.getElementById('frame').tabIndex") == 0, "keys scroll the sheet"
        name = await browser.ask("document.getElementById('take-name').textContent")
        assert served.leader.status().sessions[-1].endswith(name)
        for kind in ("depth", "sheet", "depth"):
            await browser.tap(f"[data-kind={kind}]")
            said = "startsWith('No depth')" if kind == "depth" else "trim() === ''"
            await browser.shows(f"document.getElementById('absent').textContent.{said}")
        # As when its network has gone: the socket stays open, and brings nothing.
        await browser.ask("link.socket.onmessage = () => {}; link.heard -= 20000; 0")
        await browser.shows("document.getElementById('state').textContent === 'No connection'")
        assert await browser.ask("document.getElementById('shutter').disabled"), "no take may begin later"
    finally:
        browser.kill()


async def test_a_recording_is_seen_on_each_monitor_and_ended_on_another(
    served: ServedMonitor, tmp_path: Path
) -> None:
    director = MonitorBrowser(tmp_path / "director", SIZES["phone"])
    other = MonitorBrowser(tmp_path / "other", SIZES["tablet"])
    try:
        await director.open(await served.url())
        await director.shows("document.body.classList.contains('good')")
        # A code works once: the next is for another monitor only when the first was used.
        await other.open(await served.url())
        await director.tap("[data-setting=mode] [value=video]")
        await director.tap("#shutter")
        await other.shows("document.getElementById('clock').textContent.startsWith('0:0')")
        await other.shows("document.getElementById('course').textContent.startsWith('Recording')")
        await other.tap("#shutter")
        await director.shows("document.getElementById('last-name').textContent === 'recording-001'")
    finally:
        director.kill()
        other.kill()


async def test_a_burst_is_taken_before_it_is_saved_and_its_depth_has_a_legend(tmp_path: Path) -> None:
    burst = "{name: 'burst-001', received: 0, expected: 8, seconds: 0, is_done: false}"
    async with monitored(tmp_path, 2) as served:
        browser = MonitorBrowser(tmp_path / "profile", SIZES["phone"])
        try:
            await browser.open(await served.url())
            await browser.shows("document.body.classList.contains('good')")
            assert await browser.ask(f"SHOW.burst({burst}), courseWords()[1]") == "Taking …"
            await browser.shows("document.getElementById('course').textContent.startsWith('Taken')")
            await browser.ask(
                "take = {name: 'burst-001'}, kind = 'depth', drawTake(takeKey(), new Uint8Array())"
            )
            await browser.shows("document.getElementById('absent').textContent.startsWith('Bright is near')")
        finally:
            browser.kill()


async def test_a_stranger_is_told_to_scan_the_code(served: ServedMonitor, tmp_path: Path) -> None:
    browser = MonitorBrowser(tmp_path / "profile", SIZES["phone"])
    try:
        await browser.open(served.base)
        await browser.shows("document.body.innerText.includes('scan the code')")
        assert await browser.ask("document.querySelectorAll('.camera').length") == 0
        assert await browser.ask("document.getElementById('shutter').disabled")
    finally:
        browser.kill()
