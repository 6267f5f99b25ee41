"""The page that plays splats: what it holds, and what a browser draws of it."""

import base64
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reconstruction.common.camera_paths import Frame, frame_of
from reconstruction.common.geometry import Array, View
from reconstruction.depth.seen_moment import find_subject
from reconstruction.methods.splat.gaussians import Gaussians, make_gaussians, quaternions, write_splats
from reconstruction.methods.splat.splat_page import Grid, write_splat_page
from tests.unit.reconstruction.depth.moments import moment
from tests.unit.reconstruction.walk_pages import held


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A page of two instants of a known moment; in the second, all is red."""
    cameras = moment()
    gaussians = make_gaussians(cameras)
    write_splats(tmp_path / "3.ply", gaussians)
    gaussians.colours[:] = (0.0, 0.0, 1.0)
    write_splats(tmp_path / "4.ply", gaussians)
    views = {camera: seen.view for camera, seen in cameras.items()}
    frame = frame_of(views, find_subject(cameras))
    files = {3: tmp_path / "3.ply", 4: tmp_path / "4.ply"}
    write_splat_page(tmp_path / "splat.html", "clap", files, frame, views, 33_000_000)
    return tmp_path / "splat.html"


def unpacked(text: str) -> Array:
    """The bytes that a page's script makes of a text."""
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)


def integers(packed: dict[str, Any]) -> Array:
    """What a page's script makes of packed Gaussians: rows of integers."""
    planes = unpacked(packed["splats"]).astype(int).reshape(15, packed["number"])
    codes = np.concatenate([planes[0:6:2] | planes[1:6:2] << 8, planes[6:]])
    return np.cumsum(codes >> 1 ^ -(codes & 1), axis=1).T


def test_its_numbers_are_those_of_the_gaussians(page: Path) -> None:
    gaussians, data = make_gaussians(moment()), held(page)
    rows = integers(data["instants"][0])
    assert len(rows) == len(gaussians)
    places = np.array(data["low"]) + np.array(data["step"]) * rows[:, :3]
    assert np.abs(places - gaussians.places).max() < 0.15 * np.median(gaussians.sizes[:, 0])
    sizes = data["smallest"] * np.exp(data["ratio"] * rows[:, 3:5])
    assert sizes == pytest.approx(gaussians.sizes[:, :2], rel=0.14)
    assert gaussians.sizes[:, 2] == pytest.approx(data["thin"] * gaussians.sizes[:, 0], rel=1e-5)
    turns = quaternions(gaussians.rotations)
    turns *= np.where(turns[:, :1] < 0, -1, 1)
    assert np.abs(rows[:, 5:8] / data["levels"][0] * 2 - 1 - turns[:, 1:]).max() < 0.02
    green = (rows[:, 8] << data["shifts"][0]) + 2
    blue = green + (rows[:, 9] << data["shifts"][1]) + 4
    assert np.abs(green / 255 - gaussians.colours[:, 1]).max() < 0.011
    assert np.abs(blue / 255 - gaussians.colours[:, 0]).max() < 0.026
    assert np.abs(rows[:, 11] / data["levels"][1] - gaussians.opacities).max() < 0.08


def test_what_stands_still_is_in_it_once(tmp_path: Path) -> None:
    """Each instant moves 500 others, and what has moved once stays there."""
    cameras, files, gaussians = moment(), dict[int, Path](), make_gaussians(moment())
    for instant in range(4):
        gaussians.places[500 * instant : 500 * instant + 500, 0] += 0.1
        gaussians.colours[:] = np.clip(gaussians.colours + 0.01, 0, 1)
        files[instant] = tmp_path / f"{instant}.ply"
        write_splats(files[instant], gaussians)
    views = {camera: seen.view for camera, seen in cameras.items()}
    frame = frame_of(views, find_subject(cameras))
    first, *others = held(page_of(tmp_path / "all", files, views, frame))["instants"]
    assert first["number"] == len(gaussians)
    assert all(400 <= one["number"] < 800 for one in others)
    rows = integers(first)
    for one in others:
        stay = np.unpackbits(unpacked(one["stay"]))[: len(rows)].astype(bool)
        rows = np.concatenate([rows[stay], integers(one)])
        # A few of those that move are at a place where others stay.
        assert 0.95 * len(gaussians) < len(rows) <= len(gaussians)
    last = held(page_of(tmp_path / "alone", {3: files[3]}, views, frame))["instants"][0]
    assert len(last["splats"]) < 10 * len(gaussians)


def page_of(folder: Path, files: dict[int, Path], views: dict[str, View], frame: Frame) -> Path:
    """A page of files in a new folder."""
    folder.mkdir()
    write_splat_page(folder / "splat.html", "clap", files, frame, views, 33_000_000)
    return folder / "splat.html"


def test_a_stray_costs_no_precision(tmp_path: Path) -> None:
    gaussians = make_gaussians(moment())
    far = gaussians.chosen(np.arange(1))
    far.places[:] = 1e6
    joined = Gaussians(
        **{name: np.concatenate([own, vars(far)[name]]) for name, own in vars(gaussians).items()}
    )
    write_splats(tmp_path / "stray.ply", joined)
    assert max(Grid.around({0: tmp_path / "stray.ply"}).step) < 0.5 * np.median(gaussians.sizes[:, 0])
