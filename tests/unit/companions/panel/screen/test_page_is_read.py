"""Photographs of the page: its own pixels on a screen drawn line by line, by a rolling shutter, are read."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_app.companions.panel.cycle_code import Cycle
from capture_app.companions.panel.pattern import PANELS
from capture_app.companions.panel.time_reading import read_panel
from tests.browser import CHROMIUM, Browser
from tests.unit.companions.panel.screen.browser_page import play, shown, start_browser, write_page

pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")]
WIDTH, HEIGHT = 1280, 960
ACTIVE = 0.96
"""Of a refresh a screen draws lines in so much, and is blank in the rest."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    browser = start_browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


def photograph(
    shots: list[NDArray[np.uint8]],
    way: str,
    start: float,
    exposure: float,
    row_time: float,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """A picture of a screen that shows `shots` one after the other; times are in refreshes."""
    high, wide = shots[0].shape
    scale = 0.75 * min(WIDTH / wide, HEIGHT / high)
    corners = np.array([[0, 0], [wide, 0], [wide, high], [0, high]], np.float64)
    middle = np.array([WIDTH - wide * scale, HEIGHT - high * scale]) / 2
    seen = corners * scale + middle + rng.uniform(-30, 30, (4, 2))
    matrix = cv2.getPerspectiveTransform(corners.astype(np.float32), seen.astype(np.float32))
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    there = cv2.perspectiveTransform(np.stack([columns, rows], axis=-1), np.linalg.inv(matrix))
    drawn_at = ACTIVE * (there[..., 1] / high if way == "down" else there[..., 0] / wide)
    begin = start + rows * row_time
    light = np.zeros((HEIGHT, WIDTH))
    for number, shot in enumerate(shots):
        until = np.minimum(begin + exposure, number + 1 + drawn_at)
        lit = np.clip(until - np.maximum(begin, number + drawn_at), 0, None) / exposure
        flat = cv2.warpPerspective(shot, matrix, (WIDTH, HEIGHT), flags=cv2.INTER_AREA, borderValue=60)
        light += lit * flat / 255.0
    light = cv2.GaussianBlur(light, (0, 0), 0.8)
    grey = np.clip(20 + 180 * light + rng.normal(0, 2, light.shape), 0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)


@pytest.mark.parametrize(
    ("name", "size", "angle", "way", "exposure_ms", "row_us"),
    [
        ("screen-60hz-down", (1280, 720), 0, "down", 12.0, 15.0),
        ("screen-60hz-right", (390, 844), 0, "down", 12.0, 15.0),
        ("screen-120hz-right", (844, 390), 90, "right", 4.0, 20.0),
    ],
)
def test_photographs_of_the_page_tell_its_time(
    browser: Browser,
    tmp_path: Path,
    name: str,
    size: tuple[int, int],
    angle: int,
    way: str,
    exposure_ms: float,
    row_us: float,
) -> None:
    panel = PANELS[name]
    tick_ns, rng = panel.tick_ns, np.random.default_rng(4)
    browser.open(write_page(tmp_path), width=size[0], height=size[1], angle=angle)
    rate_hz = 1e9 / tick_ns
    known = int(3 * rate_hz)
    play(browser, rate_hz, range(known))
    shots = []
    for k in range(known, known + 7):
        play(browser, rate_hz, range(k, k + 1))
        shots.append(shown(browser))
    first = int(browser.ask("counter.last")) - len(shots) + 1
    exposure, row_time = exposure_ms * 1e6 / tick_ns, row_us * 1e3 / tick_ns
    start = float(rng.uniform(2.0, 3.0))
    picture = photograph(shots, way, start, exposure, row_time, rng)
    told = read_panel(picture, exposure_ns=exposure_ms * 1e6, row_time_ns=row_us * 1e3)
    assert told.panel == panel
    assert told.cycle == Cycle(0, int(browser.ask("drawing.page")))
    # The panel's own time is that of its middle, which lies below the line of words.
    across = 0.5 if way == "right" else (24 + (size[1] - 24) / 2) / size[1]
    true = first + start + exposure / 2 + told.row * row_time - ACTIVE * across
    error = (told.middle_ns / tick_ns - true + 500) % 1000 - 500
    assert abs(error) < 0.25
    assert abs(error) < 1.5 * told.uncertainty_ns / tick_ns
