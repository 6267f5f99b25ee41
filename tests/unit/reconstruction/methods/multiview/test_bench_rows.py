"""Rows of cameras in Middlebury's layout: cameras and true depth belong together, or one plain sentence."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.reconstruction.camera_rows import read_row
from capture_app.common.errors import BadInputError

HEIGHT, WIDTH = 370, 437
DISPARITY = 120
"""Of the whole scene, px of the full size, between the two views with truth; a third of it here."""


def middlebury_row(folder: Path) -> None:
    """Seven views of a wall, each a tenth of a hundred pixels on from the last."""
    wide = np.random.default_rng(4).integers(0, 255, (HEIGHT, WIDTH + 60, 3)).astype(np.uint8)
    for number in range(7):
        cv2.imwrite(str(folder / f"view{number}.png"), wide[:, 10 * number :][:, :WIDTH])
    for number in (1, 5):
        truth = np.full((HEIGHT, WIDTH), DISPARITY, np.uint8)
        truth[:5] = 0
        cv2.imwrite(str(folder / f"disp{number}.png"), truth)
    (folder / "dmin.txt").write_text("250\n")


def test_a_point_of_the_true_depth_is_where_each_view_shows_it(tmp_path: Path) -> None:
    middlebury_row(tmp_path)
    row = read_row(tmp_path)
    depth = row.synced.depth["view1"]
    assert depth[100, 200] == pytest.approx(3740 * 0.16 / (DISPARITY + 250))
    assert not depth[:5].any()
    at = np.array([[200.0, 100.0]])
    view = row.views["view1"]
    point = view.unproject(at, depth[100:101, 200])
    for number in range(7):
        seen = row.views[f"view{number}"]
        x, y = seen.project(point @ seen.rotation.T + seen.translation)[0]
        assert (x, y) == pytest.approx((200 - 10 * (number - 1), 100))
        picture = row.synced.pictures
        assert (picture[f"view{number}"][100, round(x)] == picture["view1"][100, 200]).all()


def test_only_two_views_have_a_truth(tmp_path: Path) -> None:
    middlebury_row(tmp_path)
    known = [name for name, depth in read_row(tmp_path).synced.depth.items() if depth.any()]
    assert known == ["view1", "view5"]


@pytest.mark.parametrize("lost", ["disp5.png", "dmin.txt"])
def test_what_is_missing_is_named(tmp_path: Path, lost: str) -> None:
    middlebury_row(tmp_path)
    (tmp_path / lost).unlink()
    with pytest.raises(BadInputError, match=r"dmin.txt|not a row of cameras"):
        read_row(tmp_path)
