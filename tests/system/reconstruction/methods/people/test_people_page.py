"""The page of people: a browser draws them, and one walks all the way round them."""

from pathlib import Path

import numpy as np
import pytest

from reconstruction import open_session
from tests.browser import Browser
from tests.project import JUMPER
from tests.system.reconstruction.methods.people.labels import write_csv
from tests.unit.reconstruction.walk_pages import MIDDLE, asked, complaints, drawn, opened


@pytest.mark.parametrize("width", [390, 1280])
def test_people_are_drawn_in_all_pixels_and_seen_from_behind(
    browser: Browser, tmp_path: Path, width: int
) -> None:
    open_session(JUMPER).people(keypoints=str(write_csv(tmp_path / "labels")), out=tmp_path / "out")
    opened(browser, tmp_path / "out" / "people.html", width)
    asked(browser, MIDDLE)
    assert asked(browser, "document.documentElement.scrollWidth") == width
    assert asked(browser, "canvas.width === canvas.clientWidth")
    front = drawn(browser)
    asked(browser, "canvas.focus()")
    for _ in range(45):
        browser.press("ArrowRight", 39)
    asked(browser, "walk.draw()")
    behind = drawn(browser)
    for shown in (front, behind):
        assert np.ptp(shown, axis=2).max() > 50, "joints have a colour"
    assert np.abs(front.astype(int) - behind).max() > 80
    assert asked(browser, "walk.eye.across") == pytest.approx(4.5)
    assert complaints(browser) == []
