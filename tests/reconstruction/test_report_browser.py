"""The report in a real browser, where there is one: slider by keys and pointer, widths, no complaints."""

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from reconstruction.report import write_report
from reconstruction.results import CompareResult, DepthScores, Picture, StereoResult

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")


class Browser:
    """One page of a headless Chromium, driven over its debugging pipe (JSON ended by NUL)."""

    def __init__(self, profile: Path) -> None:
        read, its_write = os.pipe()
        its_read, write = os.pipe()
        command = [
            "bash",
            "-c",
            f'exec "$@" 3<&{its_read} 4>&{its_write}',
            "bash",
            str(CHROMIUM),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            f"--user-data-dir={profile}",
            "--remote-debugging-pipe",
        ]
        self._process = subprocess.Popen(
            command, pass_fds=(its_read, its_write), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        os.close(its_read)
        os.close(its_write)
        self._reader, self._writer = os.fdopen(read, "rb"), os.fdopen(write, "wb", buffering=0)
        self._pending = b""
        self._sent = 0
        self._session: str | None = None
        self.complaints: list[Any] = []
        self._loaded = False

    def start(self) -> None:
        target = self.do("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.do("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.do(f"{domain}.enable")

    def do(self, method: str, **params: Any) -> dict[str, Any]:
        self._sent += 1
        message = {"id": self._sent, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._writer.write(json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._sent:
                assert "error" not in answer, answer
                return answer["result"]

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._pending:
            data = os.read(self._reader.fileno(), 1 << 16)
            assert data, "the browser is gone"
            self._pending += data
        line, _, self._pending = self._pending.partition(b"\0")
        message: dict[str, Any] = json.loads(line)
        if message.get("method") in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
            self.complaints.append(message["params"])
        self._loaded |= message.get("method") == "Page.loadEventFired"
        return message

    def open(self, path: Path, *, width: int) -> None:
        self.do(
            "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False
        )
        self._loaded = False
        self.do("Page.navigate", url=path.as_uri())
        while not self._loaded:
            self._receive()

    def ask(self, expression: str) -> Any:
        return self.do("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def press(self, key: str, code: int) -> None:
        for kind in ("rawKeyDown", "keyUp"):
            self.do("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    def click(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.do("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def close(self) -> None:
        try:
            self._session = None
            self.do("Browser.close")
            self._process.wait(20)
        finally:
            self._process.kill()
            self._process.wait()
            self._reader.close()
            self._writer.close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    browser = Browser(tmp_path_factory.mktemp("profile"))
    try:
        browser.start()
        yield browser
    finally:
        browser.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("compared")
    pictures = []
    for key, shape in (("depth", (480, 640)), ("pano", (200, 2400)), ("upright", (900, 300))):
        names = [f"{key}_{side}.png" for side in ("synced", "offset")]
        for grey, name in enumerate(names):
            assert cv2.imwrite(str(out / name), np.full(shape, 100 + 80 * grey, np.uint8))
        pictures.append(Picture(key=key, title=key, synced=names[0], offset=names[1]))
    scores = DepthScores(mover_coverage=0.9, static_coverage=0.7, mover_within_2pct=0.9, instants=5)
    result = CompareResult(
        session="jump",
        offset_ms=66,
        offset_frames=2,
        actual_offset_ms=66,
        verdict="It matters.",
        calibration="given",
        stereo=StereoResult(reference="a", other="b", synced=scores, offset=scores),
        pictures=tuple(pictures),
    )
    return write_report(result, out)


AT = "getComputedStyle(document.querySelector('.pair')).getPropertyValue('--at')"


def test_the_slider_moves_by_keys_and_says_where_it_is(browser, report):
    browser.open(report, width=1280)
    browser.ask("document.querySelector('.wipe').focus()")
    assert browser.ask(AT) == "50%"

    for _ in range(3):
        browser.press("ArrowRight", 39)
    assert browser.ask(AT) == "53%"
    assert (
        browser.ask("document.querySelector('.wipe').getAttribute('aria-valuetext')") == "53 % synchronized"
    )

    browser.press("Home", 36)
    assert browser.ask(AT) == "0%"
    assert (
        browser.ask("getComputedStyle(document.querySelector('.side.synced')).clipPath")
        == "inset(0px 100% 0px 0px)"
    )


@pytest.mark.parametrize("share", [0.01, 0.25, 0.9])
def test_the_slider_follows_the_pointer(browser, report, share):
    browser.open(report, width=1280)
    browser.ask("document.querySelector('.pair').scrollIntoView()")
    box = browser.ask(
        "(r => [r.left, r.top, r.width, r.height])"
        "(document.querySelector('.pair img').getBoundingClientRect())"
    )

    browser.click(box[0] + share * box[2], box[1] + box[3] / 2)

    assert browser.ask(AT) == f"{100 * share:.0f}%"


@pytest.mark.parametrize("width", [360, 400, 700, 1400])
@pytest.mark.parametrize("view", ["over", "beside"])
def test_nothing_sticks_out_at_any_width(browser, report, width, view):
    browser.open(report, width=width)
    browser.ask(f"document.querySelector('input[value={view}]').click()")

    assert browser.ask("document.documentElement.scrollWidth") <= width
    shapes = browser.ask(
        "[...document.querySelectorAll('.side img')].map(i => i.getBoundingClientRect())"
        ".map(r => [r.width, r.height, r.right])"
    )
    wanted = [640 / 480] * 2 + [2400 / 200] * 2 + [300 / 900] * 2
    for (wide, high, right), shape in zip(shapes, wanted, strict=True):
        assert wide / high == pytest.approx(shape, rel=0.02)
        assert right <= width
    overlaid = browser.ask(
        "(([a, b]) => a.left === b.left && a.top === b.top)"
        "([...document.querySelectorAll('.side img')].slice(0, 2).map(i => i.getBoundingClientRect()))"
    )
    assert overlaid == (view == "over")


def test_print_shows_both_pictures_whole(browser, report):
    browser.open(report, width=1280)
    browser.do("Emulation.setEmulatedMedia", media="print")
    try:
        assert browser.ask("getComputedStyle(document.querySelector('.side.synced')).clipPath") == "none"
        assert browser.ask("getComputedStyle(document.querySelector('.wipe')).display") == "none"
    finally:
        browser.do("Emulation.setEmulatedMedia", media="")


def test_the_browser_has_nothing_to_complain_about(browser, report):
    browser.open(report, width=1280)

    assert browser.complaints == []
    assert (
        browser.ask(
            "performance.getEntriesByType('resource').filter(r => !r.name.startsWith('data:')).length"
        )
        == 0
    )
