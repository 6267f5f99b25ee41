"""The page of a screen's panel in a real browser, where there is one; refreshes come as the test says."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_app.companions.panel.pattern import DICTIONARY, PANEL_OF_MARKER, Panel, corners_of_marker
from tests.browser import CHROMIUM, Browser
from tests.unit.companions.panel.screen.browser_page import play, shown, start_browser, write_page
from tests.unit.companions.panel.test_pattern import is_lit

pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    browser = start_browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_page(tmp_path_factory.mktemp("page"))


def look(picture: NDArray[np.uint8]) -> tuple[Panel, tuple[bool, ...]] | None:
    """Which panel is drawn and which of its lamps are lit, by its markers; None where there are none."""
    detector = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{DICTIONARY}"))
    )
    found, numbers, _ = detector.detectMarkers(picture)
    if numbers is None:
        return None
    corners = dict(zip(np.ravel(numbers).tolist(), (np.reshape(one, (4, 2)) for one in found), strict=True))
    panel = PANEL_OF_MARKER.get(min(corners))
    assert panel is not None
    known = np.array([corner for _, *place in panel.markers for corner in corners_of_marker(*place)])
    seen = np.concatenate([corners[number] for number, _, _ in panel.markers])
    matrix, _ = cv2.findHomography(known, seen)
    places = np.array([[(lamp.x, lamp.y) for lamp in panel.lamps]])
    at = cv2.perspectiveTransform(places, matrix)[0].round().astype(int)
    return panel, tuple((picture[at[:, 1], at[:, 0]] > 127).tolist())


@cache
def _ticks(panel: Panel) -> dict[tuple[bool, ...], int]:
    lamps = panel.lamps
    return {tuple(is_lit(lamp, tick) for lamp in lamps): tick for tick in range(panel.cycle_ticks)}


def read_tick(browser: Browser) -> tuple[str, int]:
    """The panel's name and the tick that it shows."""
    read = look(shown(browser))
    assert read is not None
    return read[0].name, _ticks(read[0])[read[1]]


def status(browser: Browser) -> str:
    return str(browser.ask("document.getElementById('status').textContent"))


@pytest.mark.parametrize(
    ("rate_hz", "size", "angle", "name"),
    [
        (59.94, (1280, 720), 0, "screen-60hz-down"),
        (144.0, (1920, 1080), 0, "screen-144hz-down"),
        # A phone upright, where the panel is turned to fill it, and on either side.
        (60.0, (390, 844), 0, "screen-60hz-right"),
        (120.0, (844, 390), 90, "screen-120hz-right"),
        (90.0, (844, 390), 270, "screen-90hz-left"),
    ],
)
def test_each_refresh_shows_its_number(
    browser: Browser, page: Path, rate_hz: float, size: tuple[int, int], angle: int, name: str
) -> None:
    browser.open(page, width=size[0], height=size[1], angle=angle)
    play(browser, rate_hz, range(int(rate_hz)))
    assert look(shown(browser)) is None, "no number before the rate is known"
    play(browser, rate_hz, range(int(rate_hz), int(3 * rate_hz)))
    seen = []
    for k in range(int(3 * rate_hz), int(3 * rate_hz) + 4):
        play(browser, rate_hz, range(k, k + 1))
        seen.append(read_tick(browser))
    assert seen == [(name, seen[0][1] + n) for n in range(4)]
    assert f"{rate_hz:.2f} Hz · 0 missed" in status(browser)
    assert browser.complaints == []


def test_the_scan_goes_over_as_much_of_a_refresh_as_the_reader_takes_for_granted(
    browser: Browser, page: Path
) -> None:
    for size in ((1280, 720), (1920, 1080), (2560, 1080), (390, 844)):
        browser.open(page, width=size[0], height=size[1])
        play(browser, 60, range(200))
        dark = shown(browser) < 128
        rows = np.flatnonzero(dark.any(axis=1))
        # The markers' outer edges are half a pitch inside the panel's edges.
        read = look(shown(browser))
        assert read is not None
        pitches = read[0].height if str(read[0].scan) in ("down", "up") else read[0].width
        extent = (rows[-1] + 1 - rows[0]) * pitches / (pitches - 1)
        assert extent * 0.96 / size[1] == pytest.approx(0.9, abs=0.005)


def test_missed_refreshes_are_counted_and_the_next_number_is_right(browser: Browser, page: Path) -> None:
    browser.open(page)
    play(browser, 60, range(180))
    ticks = []
    for k in (180, 181, 184, 185):
        play(browser, 60, range(k, k + 1))
        ticks.append(read_tick(browser)[1])
    assert [tick - ticks[0] for tick in ticks] == [0, 1, 4, 5]
    play(browser, 60, range(186, 250))
    assert "2 missed" in status(browser)


@pytest.mark.parametrize("coarse_ms", [0.1, 1.0])
@pytest.mark.parametrize("rate_hz", [30.0, 59.94, 144.0, 239.76])
def test_numbers_stay_with_the_refreshes_for_long(
    browser: Browser, page: Path, rate_hz: float, coarse_ms: float
) -> None:
    """Each fiftieth callback is missing, and clocks are as coarse as browsers make them."""
    browser.open(page)
    found = browser.ask(
        f"""(() => {{
          const counter = new RefreshCounter();
          const offsets = new Set();
          for (let k = 0; k < 40 * {rate_hz}; k++) {{
            if (k % 50 === 49) continue;
            const at = Math.floor((777.123 + k * 1000 / {rate_hz}) / {coarse_ms}) * {coarse_ms};
            const number = counter.take(at, at + 2);
            if (number !== null) offsets.add(number - k);
          }}
          return [[...offsets], 1000 / counter.period];
        }})()"""
    )
    assert len(found[0]) == 1
    assert found[1] == pytest.approx(rate_hz, rel=1e-3)


@pytest.mark.parametrize(
    ("steps_ms", "problem"),
    [
        ("(k) => k * 1000 / 53.5", "there is none for 53.5 Hz"),
        ("(k) => k * 0.9", "does not wait for the screen"),
        ("(k) => k * 20 + 9 * Math.sin(k)", "the refreshes are uneven"),
    ],
)
def test_no_number_where_the_screen_cannot_tell_time(
    browser: Browser, page: Path, steps_ms: str, problem: str
) -> None:
    browser.open(page)
    browser.ask(f"for (let k = 0, at = {steps_ms}; at(k) < 3000; k++) refresh(1000 + at(k))")
    assert problem in status(browser)
    assert look(shown(browser)) is None


def test_a_screen_that_changes_its_pace_is_measured_anew(browser: Browser, page: Path) -> None:
    browser.open(page)
    play(browser, 60, range(200))
    assert look(shown(browser)) is not None
    browser.ask("for (let k = 1; k < 60; k++) refresh(1000.37 + 199 * 1000 / 60 + k * 1000 / 90)")
    assert look(shown(browser)) is None
    browser.ask("for (let k = 60; k < 400; k++) refresh(1000.37 + 199 * 1000 / 60 + k * 1000 / 90)")
    assert read_tick(browser)[0] == "screen-90hz-down"
