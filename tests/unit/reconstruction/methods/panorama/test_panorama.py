"""`reconstruct panorama` and `reconstruct stereo` as commands of their own."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from reconstruction.methods.panorama.overlap import Misalignment, OverlapScore, score_overlaps
from reconstruction.methods.panorama.registration import PanoramaStitcher, register_images
from tests.unit.reconstruction.conftest import VIEWS, Reconstruct, Scene, texture, write_session

FOCAL = 630.0


def turned(paint: np.ndarray[Any, Any], yaw_deg: float) -> np.ndarray[Any, Any]:
    """What a camera that only turns sees of a far wall, BGR uint8 360 x 480."""
    yaw = np.radians(yaw_deg)
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    into = np.array([[FOCAL, 0, 240], [0, FOCAL, 180], [0, 0, 1.0]])
    wall = np.array([[FOCAL, 0, 512], [0, FOCAL, 512], [0, 0, 1.0]])
    seen = cv2.warpPerspective(
        paint, wall @ turn @ np.linalg.inv(into), (480, 360), flags=cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
    )
    return np.asarray(cv2.cvtColor(seen, cv2.COLOR_GRAY2BGR))


def tiled(seed: int) -> np.ndarray[Any, Any]:
    """A texture with sharp corners, uint8 1024 x 1024."""
    rng = np.random.default_rng(seed)
    paint = texture(seed, 1024).copy()
    for _ in range(900):
        x, y, w, h = (int(v) for v in (*rng.integers(0, 1000, 2), *rng.integers(4, 24, 2)))
        cv2.rectangle(paint, (x, y), (x + w, y + h), int(rng.integers(20, 235)), -1)
    return paint


@pytest.fixture(scope="module")
def wall() -> dict[str, Any]:
    """Three pictures of one wall, and one of something else."""
    paint = tiled(11)
    pictures = [turned(paint, yaw) for yaw in (-16, 0, 16)]
    # The stranger comes in the middle: what follows it must still be taken for itself.
    return {"p0": pictures[0], "alien": turned(tiled(12), 0), "p1": pictures[1], "p2": pictures[2]}


def test_images_of_two_panoramas_are_separated(wall: dict[str, Any]) -> None:
    other = {f"other{number}": turned(tiled(12), yaw) for number, yaw in enumerate((3, 17))}
    pictures = {name: wall[name] for name in ("p0", "p1", "p2")} | other
    stitcher = register_images(pictures)
    assert stitcher.used == ("p0", "p1", "p2")
    assert "another panorama, with other1" in stitcher.left_out["other0"]
    assert "another panorama, with other0" in stitcher.left_out["other1"]


def judged(
    stitcher: PanoramaStitcher, images: dict[str, Any]
) -> tuple[tuple[OverlapScore, ...], Misalignment, Misalignment | None, np.ndarray[Any, Any]]:
    return score_overlaps(stitcher.layers(images), {}, stitcher.projection.canvas)


@pytest.mark.parametrize("turns", [0, 1, 2])
def test_pictures_only_shifted_or_turned_about_their_axis_come_out_whole(turns: int) -> None:
    paint = np.dstack([tiled(11)] * 3)
    pictures = {"a": paint[300:660, 200:680], "b": np.rot90(paint[300:660, 400:880], turns).copy()}
    stitcher = register_images(pictures)
    made = stitcher.compose(stitcher.layers(pictures))
    assert made.shape[1] == pytest.approx(680, abs=15)
    _, found, *_ = judged(stitcher, pictures)
    assert found.points > 100
    assert found.p95_px is not None
    assert found.p95_px < 1.5


def test_what_moved_in_the_overlap_shows_before_blending(wall: dict[str, Any]) -> None:
    pictures = {name: wall[name].copy() for name in ("p0", "p1", "p2")}
    stitcher = register_images(pictures)
    still = judged(stitcher, pictures)
    pictures["p1"][120:260, 240:480] = np.roll(pictures["p1"][120:260, 240:480], 12, axis=0)
    moved = judged(stitcher, pictures)
    worst = [max(o.misfit.p95_px or 0 for o in overlaps) for overlaps, *_ in (still, moved)]
    assert worst[0] < 1
    assert worst[1] == pytest.approx(12, abs=1)
    marked = [int((ghosts == (40, 130, 250)).all(2).sum()) for *_, ghosts in (still, moved)]
    assert marked[1] > marked[0] + 200


def test_two_exposures_and_a_mover_leave_no_seam_and_no_ghost(wall: dict[str, Any]) -> None:
    pictures = {name: wall[name].copy() for name in ("p0", "p1")}
    stitcher = register_images(pictures)
    plain = stitcher.compose(stitcher.layers(pictures)).astype(np.float32)
    pictures["p1"] = np.clip(pictures["p1"] * 0.75, 0, 255).astype(np.uint8)
    # A red disc, in the second picture only, where both see the wall.
    cv2.circle(pictures["p1"], (130, 180), 40, (0, 0, 255), -1)
    made = stitcher.compose(stitcher.layers(pictures)).astype(np.float32)
    reddish = made[..., 2] - made[..., 0]
    share_of_pale = float(((reddish > 40) & (reddish < 110)).mean())
    assert share_of_pale < 0.004, "the disc is shown whole or not at all, never half transparent"
    seen = (plain.max(2) > 0) & (made.max(2) > 0) & (np.abs(reddish) < 30)
    gain = made.mean(2) / np.maximum(plain.mean(2), 1)
    left, right = (float(np.median(gain[:, part][seen[:, part]])) for part in (slice(300), slice(400, None)))
    assert left == pytest.approx(right, abs=0.05), "both halves are equally bright"


@pytest.mark.parametrize("count", [1, 2])
def test_pictures_that_make_no_panorama_are_refused_and_leave_nothing(
    tmp_path: Path, wall: dict[str, Any], reconstruct: Reconstruct, count: int
) -> None:
    (tmp_path / "in").mkdir()
    for name in ("p0", "alien")[:count]:
        cv2.imwrite(str(tmp_path / "in" / f"{name}.png"), wall[name])
    done = reconstruct("panorama", tmp_path / "in", "--out", tmp_path / "out")
    assert done.code == 3
    assert done.err.splitlines() == [done.complaint]
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


@pytest.mark.parametrize("command", ["stereo", "calibrate", "multiview", "panorama"])
def test_a_session_of_one_camera_is_refused_in_one_line(
    command: str, scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    session = write_session(tmp_path / "in", scene, {"only": VIEWS["left"]}, instants=1)
    out = () if command == "calibrate" else ("--out", tmp_path / "out")
    done = reconstruct(command, session.folder, *out)
    assert done.code == 3
    assert done.err.splitlines() == [done.complaint]
    assert "two" in done.complaint
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_an_offset_of_a_single_instant_is_refused(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    session = write_session(tmp_path / "in", scene, VIEWS, instants=1)
    done = reconstruct("panorama", session.folder, "--condition", 66, "--out", tmp_path / "out")
    assert done.code == 3
    assert "no instant is 66 ms from instant 0" in done.complaint
