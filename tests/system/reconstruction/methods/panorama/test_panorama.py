"""`reconstruct panorama` and `reconstruct stereo` as commands of their own."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.reading.reader import Session
from reconstruction.methods.panorama.registration import register_images
from tests.imported import import_one
from tests.unit.reconstruction.conftest import Reconstruct
from tests.unit.reconstruction.methods.panorama.test_panorama import (
    judged,
    wall,  # noqa: F401 - a fixture
)


def test_three_pictures_come_out_whole_and_a_stranger_is_left_out_with_the_reason(
    wall: dict[str, Any],
) -> None:
    stitcher = register_images(wall)
    assert stitcher.used == ("p0", "p1", "p2")
    assert "shares" in stitcher.left_out["alien"]
    made = stitcher.compose(stitcher.layers(wall))
    assert made.shape[1] > 1.5 * 480
    overlaps, misfit, *_ = judged(stitcher, wall)
    assert {(o.first, o.second) for o in overlaps} >= {("p0", "p1"), ("p1", "p2")}
    assert all(o.misfit.p95_px is not None and o.misfit.p95_px < 1 for o in overlaps)
    assert misfit.points > 100
    again = register_images(wall)
    assert np.array_equal(made, again.compose(again.layers(wall)))


def test_the_panorama_does_not_depend_on_the_number_of_threads(wall: dict[str, Any]) -> None:
    before = cv2.getNumThreads()
    made = []
    try:
        for threads in (1, 4):
            cv2.setNumThreads(threads)
            stitcher = register_images(wall)
            layers = stitcher.layers(wall)
            made.append((stitcher.compose(layers), judged(stitcher, wall)[1]))
    finally:
        cv2.setNumThreads(before)
    assert np.array_equal(made[0][0], made[1][0])
    assert made[0][1] == made[1][1]


def test_stereo_writes_depth_confidence_and_picture(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    arguments = ("stereo", boards.folder, "--pair", "left,right", "--out", out, "--json")
    result = reconstruct(*arguments, "--instant", 2).result
    depth = cv2.imread(str(out / result["depth"]), cv2.IMREAD_UNCHANGED)
    confidence = cv2.imread(str(out / result["confidence"]), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.float32
    assert np.array_equal(depth > 0, confidence > 0)
    assert result["coverage"] == pytest.approx(float((depth > 0).mean()))
    assert result["within_2pct"] > 0.7
    truth = np.load(boards.ground_truth("left", 2))["depth_m"]
    wrong = (depth > 0) & (np.abs(depth - truth) > 0.02 * truth)
    right = (depth > 0) & ~wrong
    assert confidence[right].mean() > confidence[wrong].mean() + 20
    late = reconstruct(*arguments, "--instant", 9)
    assert late.code == 3
    assert "no instant 9 (it has 0 to 4)" in late.complaint


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "count", "imported"), [("boat", 6, False), ("weir_", 3, False), ("weir_", 3, True)]
)
def test_real_pictures_come_out_whole(
    shared: Path, tmp_path: Path, reconstruct: Reconstruct, name: str, count: int, imported: bool
) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    for i in range(1, count + 1):
        image = cv2.imread(str(shared / "footage" / "stitching" / f"{name}{i}.jpg"))
        small = cv2.resize(image, None, fx=800 / image.shape[1], fy=800 / image.shape[1])
        cv2.imwrite(str(folder / f"{i}.jpg"), small)
    source = folder
    if imported:
        cameras = [f"cam{i}={folder / str(i)}.jpg" for i in range(1, count + 1)]
        source = import_one(cameras, tmp_path, "stills", ImportOptions()).folder
        kept = (source / "images" / "rig1" / "cam1" / "000000.jpg").read_bytes()
        assert kept == (folder / "1.jpg").read_bytes()
    result = reconstruct("panorama", source, "--out", tmp_path / "out", "--json").result
    assert len(result["used"]) == count
    assert result["left_out"] == {}
    assert result["synced"]["width"] > 1.7 * 800
    misfit = result["synced"]["misfit"]
    assert misfit["points"] > 300
    assert misfit["median_px"] < 1
