"""The page to walk round in: what it holds, and what a browser makes of it."""

import base64
import json
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from reconstruction.methods.view.walk_page import write_walk_page
from tests.browser import CHROMIUM, Browser
from tests.reconstruction.depth.moments import BOARD_M, WALL_M, moment

NAME = "<b>clap</b>"


def held(page: Path) -> dict[str, Any]:
    """The data in a page."""
    found = re.search(r'<script id="moments" type="application/json">(.*?)</script>', page.read_text())
    return json.loads(found[1])


def picture(address: str) -> np.ndarray[Any, Any]:
    data = np.frombuffer(base64.b64decode(address.partition(",")[2]), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A page of two instants of a known moment."""
    write_walk_page(tmp_path, NAME, {3: moment(), 4: moment()}, 33_000_000)
    return tmp_path / "walk.html"


def test_it_is_one_file_that_asks_nobody(page: Path) -> None:
    text = page.read_text()
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert not re.search(r"https?://", text)
    assert NAME not in text
    assert "&lt;b&gt;clap&lt;/b&gt;" in text


def test_depth_comes_back_to_a_thousandth(page: Path) -> None:
    data = held(page)
    assert [one["instant"] for one in data["instants"]] == [3, 4]
    cameras = moment()
    for seen in data["instants"][0]["cameras"]:
        packed = picture(seen["depth"]).astype(int)
        level = (packed[..., 2] << 4) | (packed[..., 1] >> 4)
        inverse = 1 / seen["far"] + (level - 1) / 4094 * (1 / seen["near"] - 1 / seen["far"])
        truth = cameras[seen["camera"]].depth
        assert np.abs(np.where(level > 0, 1 / inverse, 0) / truth - 1).max() < 1e-3
        assert picture(seen["picture"]).shape == cameras[seen["camera"]].colours.shape


def test_its_path_lies_before_the_subject(page: Path) -> None:
    path = held(page)["path"]
    assert BOARD_M * 0.9 < path["distance"] < WALL_M * 1.1
    assert path["near"] < BOARD_M / 2
    assert path["far"] > WALL_M * 2


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("chromium is not installed")
    shown = Browser(tmp_path / "profile", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    shown.start()
    yield shown
    shown.close()


def asked(browser: Browser, expression: str) -> Any:
    found = browser.do("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
    return found["result"].get("value")


def opened(browser: Browser, page: Path, width: int, until: str) -> None:
    browser.do(
        "Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=True
    )
    browser.do("Page.navigate", url=page.as_uri())
    for _ in range(300):
        if asked(browser, until):
            return
        time.sleep(0.1)
    pytest.fail("the page shows nothing")


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_a_browser_draws_what_the_cameras_saw(browser: Browser, page: Path, width: int) -> None:
    opened(browser, page, width, "window.walk && walk.count() > 0")
    assert asked(browser, "document.documentElement.scrollWidth") == width
    asked(browser, "walk.stop(); Object.assign(walk.eye, {across: 0, down: 0, nearer: 0}); walk.draw()")
    shot = browser.do("Page.captureScreenshot", format="png")["data"]
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(shot), np.uint8), cv2.IMREAD_COLOR)
    box = json.loads(
        asked(browser, "JSON.stringify(document.getElementById('canvas').getBoundingClientRect())")
    )
    left, top, right, bottom = (round(box[side]) for side in ("left", "top", "right", "bottom"))
    size = right - left, bottom - top
    still = re.search(r'<img alt="[^"]*" src="([^"]*)"', page.read_text())[1]
    expected = cv2.resize(picture(still), size)
    drawn = shown[top:bottom, left:right]
    middle = np.s_[size[1] // 8 : -size[1] // 8, size[0] // 8 : -size[0] // 8]
    blurred = [cv2.GaussianBlur(one, (0, 0), 2)[middle].astype(float) for one in (drawn, expected)]
    assert np.abs(blurred[0] - blurred[1]).mean() < 12
    asked(browser, "document.getElementById('at').value = 1; document.getElementById('at').oninput")
    asked(browser, "document.getElementById('at').dispatchEvent(new Event('input'))")
    assert asked(browser, "document.getElementById('now').textContent") == "instant 4"
    assert [one for one in browser.complaints if "GPU stall" not in str(one)] == []


@pytest.mark.slow
def test_without_webgl_it_shows_a_picture(tmp_path: Path, page: Path) -> None:
    if CHROMIUM is None:
        pytest.skip("chromium is not installed")
    shown = Browser(tmp_path / "profile", "--disable-3d-apis")
    shown.start()
    try:
        opened(shown, page, 390, "document.getElementById('hint').textContent.includes('no 3D')")
        assert asked(shown, "document.querySelector('img').naturalWidth") == 120
        assert asked(shown, "getComputedStyle(document.getElementById('controls')).display") == "none"
    finally:
        shown.close()
