"""The page in a real browser with a fake camera: joins by the code, is killed, comes back; what it says."""

import asyncio
import re
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.camera_facts import Control
from capture_app.common.node_state import NodeState
from capture_app.protocol.orders import ControlsAnswer, ControlsRequest
from capture_app.rig.rig_link import ask_leader
from capture_app.session.reading.verify import verify
from tests.browser import CHROMIUM, Browser
from tests.companions.phones.places import Place, burst, measured, serving
from tests.waiting import TIMEOUT_S, until

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs a headless Chromium")

CAMERA = ("--use-fake-device-for-media-stream=fps=15", "--ignore-certificate-errors")
ALLOW = "--use-fake-ui-for-media-stream"
WITHOUT_PROCESSOR = "delete self.MediaStreamTrackProcessor"
SLOW_FRAMES = """
const ask = HTMLVideoElement.prototype.requestVideoFrameCallback;
HTMLVideoElement.prototype.requestVideoFrameCallback = function (shown) {
  return ask.call(this, () => setTimeout(() => ask.call(this, shown), 1500));
};"""
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


async def join(phone: PhoneBrowser, place: Place) -> None:
    """Open the page of the code and start the camera, as a user does."""
    await phone.open(place.url)
    await phone.shows("Start the camera")
    await phone.ask("document.getElementById('wish').value = 'window'")
    await phone.ask("document.getElementById('go').click()")
    await measured(place, "window")
    await phone.shows("known to ±")


def pictures_sent(text: str) -> int:
    """How many pictures the page says that it has sent."""
    said = re.search(r"(\d+) pictures?", text)
    return int(said[1]) if said else 0


@pytest.mark.slow
async def test_a_camera_that_begins_slowly_is_waited_for(place: Place, tmp_path: Path) -> None:
    """Two frames in three seconds, as WebKit gave on a busy machine, were 'no picture'."""
    phone = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await phone.open(place.url, before=f"{WITHOUT_PROCESSOR}; {SLOW_FRAMES}")
        await phone.shows("Start the camera")
        await phone.ask("document.getElementById('go').click()")
        await phone.shows("320×240")
        assert "gave no picture" not in await phone.text()
    finally:
        phone.kill()


@pytest.mark.slow
async def test_a_browser_joins_by_the_code_and_takes_a_burst(
    place: Place, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    phone = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await join(phone, place)
        assert not await phone.ask("location.hash")
        session = await burst(place, 3, wait_ready_s=0)
        assert verify(session) == []
        assert len(session.manifest.images) == 3
        (camera,) = session.manifest.cameras
        assert (camera.facts.width, camera.facts.height) == (320, 240)
        assert camera.clock is not None
        assert camera.clock.device_uncertainty_ns
        # Pictures of spare instants are fetched, too, before the leader knows that a burst is whole.
        await phone.shows_what(lambda text: pictures_sent(text) >= 3, "3 pictures sent or more")
    finally:
        phone.kill()
    await until(lambda: place.state("window") is NodeState.FAILED)
    assert [record.getMessage() for record in caplog.records if record.exc_info] == []


@pytest.mark.slow
async def test_a_browser_that_was_hidden_or_killed_comes_back(place: Place, tmp_path: Path) -> None:
    phone = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await join(phone, place)
        request = ControlsRequest(camera="window", values={Control.EXPOSURE: 4_000.0})
        set_to = (await ask_leader(place.leader.own_address, request, ControlsAnswer)).state
        assert set_to.problems == {}
        exposure = set_to.state(Control.EXPOSURE)
        assert exposure is not None
        assert exposure.value == 4_000.0
        await phone.hide()
        await until(lambda: place.state("window") is NodeState.FAILED)
        await phone.show()
        await measured(place, "window")
    finally:
        phone.kill()
    await until(lambda: place.state("window") is NodeState.FAILED)

    # The phone's system starts it again at the address that it had, which holds no secret.
    again = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await again.open(place.base)
        await measured(place, "window")
        assert len((await burst(place, 2, wait_ready_s=0)).manifest.images) == 2
    finally:
        again.kill()


@pytest.mark.slow
async def test_a_browser_that_shows_frames_to_nobody_is_read_by_its_video(
    place: Place, tmp_path: Path
) -> None:
    phone = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await phone.open(place.url, before=WITHOUT_PROCESSOR)
        await phone.ask("document.getElementById('go').click()")
        await measured(place, "phone")
        assert len((await burst(place, 1, wait_ready_s=0)).manifest.images) == 1
    finally:
        phone.kill()


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
