"""The page to walk round in: what it holds, and what a browser makes of it."""

import re
from pathlib import Path

import numpy as np
import pytest

from reconstruction.methods.view.walk_page import write_moments
from tests.browser import CHROMIUM, Browser
from tests.reconstruction.depth.moments import BOARD_M, WALL_M, moment
from tests.reconstruction.walk_pages import asked, complaints, difference, held, opened, picture

NAME = "<b>clap</b>"


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A page of two instants of a known moment."""
    write_moments(tmp_path, NAME, {3: moment(), 4: moment()}, 33_000_000)
    return tmp_path / "walk.html"


def test_it_is_one_file_that_asks_nobody(page: Path) -> None:
    text = page.read_text()
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert not re.search(r"https?://", text)
    assert NAME not in text
    assert "&lt;b&gt;clap&lt;/b&gt;" in text


def test_depth_comes_back_to_a_thousandth(page: Path) -> None:
    data = held(page)
    assert [one["instant"] for one in data["instants"]] == [3, 4]
    cameras = moment()
    for seen in data["instants"][0]["cameras"]:
        packed = picture(seen["depth"]).astype(int)
        level = (packed[..., 2] << 4) | (packed[..., 1] >> 4)
        inverse = 1 / seen["far"] + (level - 1) / 4094 * (1 / seen["near"] - 1 / seen["far"])
        truth = cameras[seen["camera"]].depth
        assert np.abs(np.where(level > 0, 1 / inverse, 0) / truth - 1).max() < 1e-3
        assert picture(seen["picture"]).shape == cameras[seen["camera"]].colours.shape


def test_its_path_lies_before_the_subject(page: Path) -> None:
    path = held(page)["path"]
    assert BOARD_M * 0.9 < path["distance"] < WALL_M * 1.1
    assert path["near"] < BOARD_M / 2
    assert path["far"] > WALL_M * 2


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_a_browser_draws_what_the_cameras_saw(browser: Browser, page: Path, width: int) -> None:
    opened(browser, page, width)
    assert asked(browser, "document.documentElement.scrollWidth") == width
    assert difference(browser, page) < 12
    asked(browser, "document.getElementById('at').value = 1; document.getElementById('at').oninput")
    asked(browser, "document.getElementById('at').dispatchEvent(new Event('input'))")
    assert asked(browser, "document.getElementById('now').textContent") == "instant 4"
    assert complaints(browser) == []


@pytest.mark.slow
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
