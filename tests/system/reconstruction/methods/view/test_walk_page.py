"""The page to walk round in: what it holds, and what a browser makes of it."""

from pathlib import Path

import pytest

from tests.browser import CHROMIUM, Browser
from tests.unit.reconstruction.methods.view.test_walk_page import page  # noqa: F401 - a fixture
from tests.unit.reconstruction.walk_pages import asked, complaints, difference, opened


@pytest.mark.parametrize("width", [390, 1280])
def test_a_browser_draws_what_the_cameras_saw(browser: Browser, page: Path, width: int) -> None:
    opened(browser, page, width)
    assert asked(browser, "document.documentElement.scrollWidth") == width
    assert difference(browser, page) < 12
    asked(browser, "document.getElementById('at').value = 1; document.getElementById('at').oninput")
    asked(browser, "document.getElementById('at').dispatchEvent(new Event('input'))")
    assert asked(browser, "document.getElementById('now').textContent") == "instant 4"
    assert complaints(browser) == []


def test_an_upright_phone_is_filled_and_has_the_controls_below_in_reach(browser: Browser, page: Path) -> None:
    opened(browser, page, 390)
    above, picture, below = (
        asked(browser, f"(r => [r.left, r.top, r.right, r.bottom])({part}.getBoundingClientRect())")
        for part in ("document.querySelector('h1')", "canvas", "document.getElementById('controls')")
    )
    assert (picture[0], picture[2]) == (0, 390)
    assert above[3] < picture[1]
    assert picture[3] < below[1]
    assert 740 < below[3] <= 800
    assert picture[3] - picture[1] > 500, "a picture of 4:3 fills it, too"


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
