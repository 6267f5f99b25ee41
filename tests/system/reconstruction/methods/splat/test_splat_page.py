"""The page that plays splats: what it holds, and what a browser draws of it."""

from pathlib import Path

import pytest

from tests.browser import Browser
from tests.unit.reconstruction.methods.splat.test_splat_page import page  # noqa: F401 - a fixture
from tests.unit.reconstruction.walk_pages import MIDDLE, asked, complaints, difference, drawn, opened


@pytest.mark.parametrize("width", [390, 1280])
def test_a_browser_draws_the_splats_of_each_instant(browser: Browser, page: Path, width: int) -> None:
    opened(browser, page, width)
    assert asked(browser, "document.documentElement.scrollWidth") == width
    assert difference(browser, page) < 4
    asked(browser, "document.getElementById('at').value = 1")
    asked(browser, "document.getElementById('at').dispatchEvent(new Event('input'))")
    asked(browser, "new Promise(done => setTimeout(done, 1000))")
    asked(browser, MIDDLE)
    blue, green, red = drawn(browser).reshape(-1, 3).mean(axis=0)
    assert red > 200 > 20 > max(blue, green)
    assert complaints(browser) == []
