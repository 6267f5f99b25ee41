"""The page that plays splats: what it holds, and what a browser draws of it."""

import base64
import zlib
from pathlib import Path

import numpy as np
import pytest

from reconstruction.common.camera_paths import frame_of
from reconstruction.depth.seen_moment import find_subject
from reconstruction.methods.splat.gaussians import Gaussians, make_gaussians, quaternions, write_splats
from reconstruction.methods.splat.splat_page import pack, write_splat_page
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
    write_splat_page(tmp_path, "clap", files, frame, views, 33_000_000)
    return tmp_path / "walk.html"


def words(page: Path) -> tuple[dict[str, object], np.ndarray]:
    one = held(page)["instants"][0]
    data = zlib.decompress(base64.b64decode(one["splats"]))
    return one, np.frombuffer(data, "<u4").reshape(4, one["number"])


def test_its_numbers_are_those_of_the_gaussians(page: Path) -> None:
    gaussians, (one, packed) = make_gaussians(moment()), words(page)
    assert one["number"] == len(gaussians)
    integers = np.stack([packed[0] & 65535, packed[0] >> 16, packed[1] & 65535], axis=1)
    places = np.array(one["low"]) + np.array(one["step"]) * integers
    assert np.abs(places - gaussians.places).max() < 1e-4
    sizes = np.stack([packed[1] >> 16 & 255, packed[1] >> 24, packed[2] & 255], axis=1)
    assert one["smallest"] * np.exp(one["ratio"] * sizes) == pytest.approx(gaussians.sizes, rel=0.02)
    blue = (packed[3] >> 16 & 255) / 255
    assert np.abs(blue - gaussians.colours[:, 0]).max() < 0.003
    axes = gaussians.axes.astype(float)
    axes[:, :, 2] *= np.sign(np.linalg.det(axes))[:, None]
    turns = quaternions(axes)
    turns *= np.where(turns[:, :1] < 0, -1, 1)
    x = (packed[2] >> 8 & 255) / 127.5 - 1
    assert np.abs(x - turns[:, 1]).max() < 0.005


def test_a_stray_costs_no_precision() -> None:
    gaussians = make_gaussians(moment())
    far = gaussians.chosen(np.arange(1))
    far.places[:] = 1e6
    joined = Gaussians(
        **{name: np.concatenate([own, vars(far)[name]]) for name, own in vars(gaussians).items()}
    )
    packed = pack(joined)
    assert packed["number"] == len(gaussians)
    assert max(packed["step"]) < 1e-3
