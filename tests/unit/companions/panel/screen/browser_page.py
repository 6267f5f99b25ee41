"""The page of a screen's panel in a browser whose refreshes come as a test says."""

import base64
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.companions.panel.screen import page_html
from tests.browser import Browser

CLOCK = """
let callback = null, now = 0;
window.requestAnimationFrame = (asked) => { callback = asked; return 1; };
performance.now = () => now;
window.refresh = (ms) => { now = ms; const due = callback; callback = null; due(ms); };
"""
"""The browser's clock and screen: `refresh(ms)` is a refresh at that time."""


def start_browser(profile: Path) -> Browser:
    """A browser that stands still between refreshes."""
    browser = Browser(profile)
    try:
        browser.start()
        browser.do("Page.addScriptToEvaluateOnNewDocument", source=CLOCK)
    except BaseException:
        browser.close()
        raise
    return browser


def write_page(folder: Path) -> Path:
    file = folder / "panel.html"
    file.write_bytes(page_html())
    return file


def play(
    browser: Browser, rate_hz: float, refreshes: range, *, coarse_ms: float = 0.1, skip: int = 0
) -> None:
    """Let refreshes happen; of `skip` of them each one goes without a callback."""
    browser.ask(
        f"for (let k = {refreshes.start}; k < {refreshes.stop}; k++) if (!{skip} || k % {skip}) "
        f"refresh(Math.floor((1000.37 + k * 1000 / {rate_hz}) / {coarse_ms}) * {coarse_ms})"
    )


def shown(browser: Browser) -> NDArray[np.uint8]:
    """What stands on the page's canvas."""
    data = browser.ask("document.getElementById('panel').toDataURL('image/png')").split(",")[1]
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_GRAYSCALE)
    return np.asarray(picture, np.uint8)
