"""The page to walk round in: what it holds, and what a browser makes of it."""

import re
from pathlib import Path

import numpy as np
import pytest

from reconstruction.depth.seen_moment import find_subject
from reconstruction.methods.view.walk_page import write_moments
from tests.unit.reconstruction.depth.moments import BOARD_M, WALL_M, moment
from tests.unit.reconstruction.walk_pages import held, picture

NAME = "<b>clap</b>"


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A page of two instants of a known moment."""
    write_moments(tmp_path, NAME, {3: moment(), 4: moment()}, find_subject(moment()), 33_000_000)
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
