"""The page that plays splats: what it holds, and what a browser draws of it."""

from pathlib import Path

import pytest

from tests.browser import Browser
from tests.unit.reconstruction.methods.splat.test_splat_page import page  # noqa: F401 - a fixture
from tests.unit.reconstruction.walk_pages import MIDDLE, asked, complaints, difference, drawn, opened


@pytest.mark.parametrize(("width", "emulation"), [(390, "swiftshader"), (390, "none"), (1280, "swiftshader")])
def test_a_browser_draws_the_splats_of_each_instant(
    browser: Browser, page: Path, width: int, emulation: str
) -> None:
    """The browser of the tests emulates a GPU; a page that does not know it draws by the GPU's way."""
    page.write_text(page.read_text().replace("swiftshader|", f"{emulation}|"))
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


def test_its_first_sight_is_whole_and_then_it_swings(browser: Browser, page: Path) -> None:
    opened(browser, page, 640)
    asked(browser, "new Promise(done => setTimeout(done, 600))")
    at_first = asked(browser, "[walk.eye.across, canvas.width]")
    assert at_first == [0, asked(browser, "walk.draw(); canvas.width")]
    asked(browser, "new Promise(done => setTimeout(done, 2500))")
    assert asked(browser, "walk.eye.across") != 0


def test_it_moves_in_fewer_pixels_and_rests_in_all(browser: Browser, page: Path) -> None:
    """Where a picture takes long, pictures of a moving eye are smaller; the last one is whole again."""
    opened(browser, page, 640)
    whole = asked(browser, "walk.stop(); walk.draw(); canvas.width")
    asked(browser, "window.time = performance.now.bind(performance); window.late = 0")
    asked(browser, "performance.now = () => window.time() + (window.late += 60)")
    asked(browser, "document.getElementById('swing').click()")
    asked(browser, "new Promise(done => setTimeout(done, 700))")
    assert asked(browser, "canvas.width") < 0.8 * whole
    asked(browser, "walk.stop()")
    asked(browser, "new Promise(done => setTimeout(done, 700))")
    assert asked(browser, "canvas.width") == whole
    assert complaints(browser) == []
