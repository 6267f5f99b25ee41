"""The cloud of a page: packed in few bytes, of the same part of space on both sides."""

import base64
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.session.exporting.point_cloud import PointCloud, read_ply, write_ply
from reconstruction.pages import embedding
from reconstruction.pages.embedding import InstantClouds, view_clouds

TURN = cv2.Rodrigues(np.array([0.1, 0.7, -0.2]))[0]
CENTRE = np.array([1.0, -2.0, 0.5])


def unpack(packed: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    data = base64.b64decode(packed["data"])
    places = np.frombuffer(data, "<i2", 3 * packed["points"]).reshape(-1, 3)
    colours = np.frombuffer(data, np.uint8, offset=6 * packed["points"]).reshape(-1, 3)
    return np.array(packed["middle"]) + packed["step"] * places, colours


def save(out: Path, synced: np.ndarray, offset: np.ndarray) -> InstantClouds:
    for name, points in (("synced", synced), ("offset", offset)):
        rig = points @ TURN + CENTRE
        colours = (np.arange(points.size).reshape(-1, 3) % 256).astype(np.uint8)
        write_ply(out / f"{name}.ply", PointCloud(rig, colours))
    return InstantClouds(
        instant=3,
        synced="synced.ply",
        offset="offset.ply",
        rotation=tuple(TURN.ravel()),
        centre=tuple(CENTRE),
        focal=0.9,
        pivot=tuple(np.array([0.0, 0.0, 4.0]) @ TURN + CENTRE),
    )


def test_points_come_back_in_the_first_cameras_frame(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-1, -1, 3], [1, 1, 6], (2_000, 3))
    view = view_clouds(save(tmp_path, points, points + 0.01), tmp_path, "cam1", 5)
    shown, colours = unpack(view["synced"])
    assert view["pivot"] == pytest.approx((0, 0, 4), abs=1e-6)
    assert view["synced"]["of"] == 2_000
    assert 0.93 * 2_000 < view["synced"]["points"] < 2_000
    apart = np.linalg.norm(shown[:, None] - points[None], axis=2)
    assert apart.min(1).max() < 1e-3
    nearest = apart.argmin(1)
    assert (colours == (np.arange(6_000).reshape(-1, 3) % 256)[nearest]).all()


def test_both_sides_show_the_same_part_of_space(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform([-1, -1, 3], [1, 1, 6], (3_000, 3))
    stray = np.vstack([points[:100], points[100:] + 50])
    view = view_clouds(save(tmp_path, points, stray), tmp_path, "cam1", 5)
    assert 90 <= view["offset"]["points"] <= 100
    assert view["offset"]["of"] == 3_000


def test_large_clouds_are_thinned_evenly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embedding, "MAX_POINTS", 52_000)
    points = np.random.default_rng(3).uniform([-1, -1, 3], [1, 1, 6], (80_000, 3))
    view = view_clouds(save(tmp_path, points, points[:5]), tmp_path, "cam1", 5)
    shown, _ = unpack(view["synced"])
    assert len(shown) == 26_000
    assert shown.mean(0) == pytest.approx([0, 0, 4.5], abs=0.03)
    assert len(view["synced"]["data"]) < 320_000


def test_the_file_of_points_is_a_ply_that_comes_back_whole(tmp_path: Path) -> None:
    points = np.array([[0.5, -1, 2], [3, 4, 5]])
    colours = np.array([[1, 2, 3], [254, 255, 0]], np.uint8)
    write_ply(tmp_path / "deep" / "cloud.ply", PointCloud(points, colours))
    found = read_ply(tmp_path / "deep" / "cloud.ply")
    assert (found.points == points).all()
    assert (found.colours == colours).all()


@pytest.mark.parametrize("broken", ["missing", "cut", "other"])
def test_a_cloud_that_cannot_be_read_is_one_clear_error(tmp_path: Path, broken: str) -> None:
    path = tmp_path / "cloud.ply"
    write_ply(path, PointCloud(np.zeros((20, 3)), np.zeros((20, 3), np.uint8)))
    if broken == "missing":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-3] if broken == "cut" else b"solid cube")
    with pytest.raises(IncompleteError if broken == "missing" else BadInputError, match=r"cloud\.ply"):
        read_ply(path)
