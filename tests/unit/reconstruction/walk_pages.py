"""Pages to walk round in, for their tests: what they hold, and what a browser draws of them."""

import base64
import json
import re
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.browser import Browser

MIDDLE = "walk.stop(); Object.assign(walk.eye, {across: 0, down: 0, nearer: 0}); walk.draw()"


def held(page: Path) -> dict[str, Any]:
    """The data in a page."""
    found = re.search(r'<script id="moments" type="application/json">(.*?)</script>', page.read_text())
    return json.loads(found[1])


def picture(address: str) -> np.ndarray[Any, Any]:
    data = np.frombuffer(base64.b64decode(address.partition(",")[2]), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


def still(page: Path) -> np.ndarray[Any, Any]:
    """The picture from the middle, for browsers without 3D."""
    return picture(re.search(r'<img alt="[^"]*" src="([^"]*)"', page.read_text())[1])


def asked(browser: Browser, expression: str) -> Any:
    found = browser.do("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
    return found["result"].get("value")


def opened(browser: Browser, page: Path, width: int, until: str = "window.walk && walk.count() > 0") -> None:
    browser.do(
        "Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=True
    )
    browser.do("Page.navigate", url=page.as_uri())
    for _ in range(300):
        if asked(browser, until):
            return
        time.sleep(0.1)
    pytest.fail("the page shows nothing")


def drawn(browser: Browser) -> np.ndarray[Any, Any]:
    """What the page's canvas shows."""
    shot = browser.do("Page.captureScreenshot", format="png")["data"]
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(shot), np.uint8), cv2.IMREAD_COLOR)
    box = json.loads(
        asked(browser, "JSON.stringify(document.getElementById('canvas').getBoundingClientRect())")
    )
    left, top, right, bottom = (round(box[side]) for side in ("left", "top", "right", "bottom"))
    return shown[top:bottom, left:right]


def difference(browser: Browser, page: Path) -> float:
    """The mean difference of grey levels of what is drawn from the middle to the page's picture, blurred."""
    asked(browser, MIDDLE)
    shown = drawn(browser)
    expected = still(page)
    scales = sorted(has / of for has, of in zip(shown.shape[:2], expected.shape[:2], strict=True))
    expected = cv2.resize(expected, None, fx=(scale := min(scales[1], 1.5 * scales[0])), fy=scale)
    height, width = (min(sides) * 3 // 4 for sides in zip(shown.shape[:2], expected.shape[:2], strict=True))
    middles = [
        cv2.getRectSubPix(
            cv2.GaussianBlur(one, (0, 0), 2), (width, height), (one.shape[1] / 2, one.shape[0] / 2)
        )
        for one in (shown, expected)
    ]
    return float(np.abs(middles[0].astype(float) - middles[1]).mean())


def complaints(browser: Browser) -> list[Any]:
    return [one for one in browser.complaints if "GPU stall" not in str(one)]
