"""The page in three engines with fake cameras: joining, being ready with an own error bar, whole bursts."""

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.node_state import NodeState
from capture_app.console.terminal import talk
from capture_app.session.reading.verify import verify
from tests.browser import CHROMIUM, Browser
from tests.other_browsers import FIREFOX, MINI_BROWSER, WEBKIT_DRIVER, XVFB, Firefox, WebKit
from tests.unit.companions.phones.places import burst, ready, serving
from tests.waiting import until

BURSTS, FRAMES = 5, 3


class Chromium(Browser):
    """Chromium by the names of the other two."""

    def __init__(self, profile: Path) -> None:
        camera = "--use-fake-device-for-media-stream=fps=30", "--use-fake-ui-for-media-stream"
        super().__init__(profile, *camera, "--ignore-certificate-errors")
        self.version = self.do("Browser.getVersion")["product"]
        self.start()


ENGINES: dict[str, tuple[bool, Callable[[Path], Any]]] = {
    "chromium": (CHROMIUM is not None, Chromium),
    "firefox-esr": (FIREFOX is not None, Firefox),
    "webkit2gtk-driver, xvfb": (None not in (WEBKIT_DRIVER, XVFB, MINI_BROWSER), WebKit),
}


@pytest.mark.timeout(400)
@pytest.mark.parametrize("packages", ENGINES)
async def test_a_phones_page_takes_whole_bursts_in_each_engine(packages: str, tmp_path: Path) -> None:
    is_here, engine = ENGINES[packages]
    if not is_here:
        pytest.skip(f"apt-get install {packages}")
    async with serving(tmp_path, (640, 480)) as place:
        browser = await asyncio.to_thread(engine, tmp_path / "profile")
        try:
            began = time.monotonic()
            await asyncio.to_thread(browser.open, place.url)
            await asyncio.to_thread(browser.ask, "document.getElementById('go').click()")
            await until(lambda: place.state("phone"), seconds=200)
            joined_s = time.monotonic() - began
            await ready(place, "phone")
            ready_s = time.monotonic() - began
            (node,) = place.leader.status().nodes
            alignment = f"{node.message or 'in step'}; {node.camera.width}x{node.camera.height}"
            waited = f"joined after {joined_s:.0f} s, {node.state} after {ready_s:.0f} s"
            talk(f"{browser.version}: {waited}: {alignment}")
            for _ in range(BURSTS):
                session = await burst(place, FRAMES)
                assert verify(session) == []
                assert all(image.uncertainty_ns for image in session.manifest.images)
            text = await asyncio.to_thread(browser.ask, "document.body.innerText")
            assert any(word in text for word in ("Ready", "Getting in step", "Measuring")), text
            assert place.state("phone") not in (NodeState.FAILED, NodeState.LOST)
        finally:
            await asyncio.to_thread(browser.kill)
