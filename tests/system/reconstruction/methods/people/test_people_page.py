"""The page of people: a browser draws them, and one walks all the way round them."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from reconstruction import open_session
from tests.browser import Browser
from tests.project import JUMPER
from tests.system.reconstruction.methods.people.labels import write_csv
from tests.unit.reconstruction.walk_pages import MIDDLE, asked, complaints, drawn, held, opened


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


def test_joints_of_large_errors_are_rings_that_hide_nothing(browser: Browser, tmp_path: Path) -> None:
    open_session(JUMPER).people(keypoints=str(write_csv(tmp_path / "labels")), out=tmp_path / "out")
    page = tmp_path / "out" / "people.html"
    text, data = page.read_text(encoding="utf-8"), held(page)
    for instant in data["instants"]:
        for person in instant["people"]:
            for joint in filter(None, person):
                joint[3] = 50.0
    page.write_text(
        re.sub(r'(id="moments"[^>]*>).*?(?=</script>)', r"\1" + json.dumps(data), text), encoding="utf-8"
    )
    opened(browser, page, 1280)
    assert 0 < (np.ptp(drawn(browser), axis=2) > 15).mean() < 0.05
    assert asked(browser, "document.getElementById('hint').textContent.includes('a ring is an unsure joint')")
