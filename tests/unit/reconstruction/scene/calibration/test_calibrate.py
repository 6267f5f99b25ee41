"""`reconstruct calibrate`: judged, refused with a reason, stored once."""

import shutil
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.board.boards import CharucoBoard
from capture_app.board.detector import is_flat_board
from capture_app.common.errors import BadInputError
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.common.geometry import View
from reconstruction.scene.calibration.board_calibration import detect_board
from reconstruction.scene.calibration.consistency import (
    CalibrationQuality,
    lens_knowledge,
    refuse_bad_calibration,
)
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import (
    HEIGHT,
    VIEWS,
    WIDTH,
    Reconstruct,
    Scene,
    add_image,
    finish_session,
    write_session,
)

BOARD = CharucoBoard(6, 5, 0.10, 0.075, "4X4_50")
SEEN_BY = {"left": VIEWS["left"], "right": VIEWS["right"]}
TEXEL_PX = 60


def board_session(root: Path, *, two_sided: bool = False) -> Session:
    """A recording of the board, held at eight places, by two cameras.

    `two_sided`: printed white on black, and the right camera's pictures show its back as in a mirror.
    """
    paint = BOARD.to_opencv().generateImage((BOARD.across * TEXEL_PX, BOARD.down * TEXEL_PX), marginSize=0)
    paint = 255 - paint if two_sided else paint
    writer = SessionWriter.create(root, "board")
    for k in range(8):
        angles = np.radians([18 * np.sin(2.1 * k), 22 * np.cos(1.3 * k), 7 * k])
        turn = cv2.Rodrigues(angles)[0]
        centre = np.array([0.12 * np.sin(k), 0.1 * np.cos(2 * k), 1.15 + 0.06 * (k % 3)])
        corner = centre - turn @ np.array([BOARD.across * 0.05, BOARD.down * 0.05, 0])
        for name, view in SEEN_BY.items():
            into = view.matrix @ view.rotation @ np.column_stack([turn[:, 0], turn[:, 1], corner])
            into[:, 2] += view.matrix @ view.translation
            metres = np.diag([0.10 / TEXEL_PX, 0.10 / TEXEL_PX, 1.0])
            # Painted four times as large and made smaller, for edges as a camera sees them.
            grown = np.diag([4.0, 4.0, 1.0]) @ np.array([[1, 0, 0.375], [0, 1, 0.375], [0, 0, 1.0]])
            large = cv2.warpPerspective(
                paint, grown @ into @ metres, (4 * WIDTH, 4 * HEIGHT), borderValue=(190.0,)
            )
            image = cv2.resize(large, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
            if two_sided and name == "right":
                image = np.ascontiguousarray(image[:, ::-1])
            add_image(writer, name, k, image)
    return finish_session(writer, SEEN_BY, 8)


def baseline(first: View, second: View) -> float:
    return float(np.linalg.norm(first.centre - second.centre))


def test_a_board_gives_the_rig_and_is_stored_once(tmp_path: Path, reconstruct: Reconstruct) -> None:
    session = board_session(tmp_path)
    board = "--board", "6x5", "--square-mm", 100, "--marker-mm", 75
    arguments = "calibrate", session.folder, "--from", "charuco", *board, "--json"
    result = reconstruct(*arguments).result
    assert result["stored"]
    assert result["quality"]["reprojection_error_px"] < 0.5
    assert result["quality"]["inlier_share"] > 0.95
    found = Session.open(session.folder).calibration()
    assert found is not None
    views = [View.from_calibration(found.cameras[name], WIDTH, HEIGHT) for name in ("left", "right")]
    assert baseline(*views) == pytest.approx(baseline(VIEWS["left"], VIEWS["right"]), rel=0.05)
    assert views[0].focal == pytest.approx(VIEWS["left"].focal, rel=0.05)
    # A board's error counts against depth as one of structure from motion does.
    off = [errors["focal_percent"] / 100 for errors in result["errors"].values()]
    assert found.lenses == lens_knowledge(off)
    assert found.source.endswith(f", {lens_knowledge(off).text}")

    stored = (session.folder / "calibration.json").read_bytes()
    refused = reconstruct(*arguments)
    assert refused.code == 3
    assert "--replace" in refused.complaint
    assert (session.folder / "calibration.json").read_bytes() == stored
    again = reconstruct(*arguments[:-1], "--replace")
    assert again.code == 0
    assert "imported ones take it by --from kept" in again.out
    assert not list(session.folder.glob("*.part"))


def test_few_cameras_or_few_points_are_refused() -> None:
    found = CalibrationQuality(
        points=35,
        inlier_share=0.8,
        reprojection_error_px=0.4,
        triangulation_angle_deg=13.0,
        coverage={"a": 0.2, "b": 0.2},
    )
    with pytest.raises(BadInputError, match="only 2 of 5 cameras"):
        refuse_bad_calibration(found, 5)
    with pytest.raises(BadInputError, match="share only 35 points"):
        refuse_bad_calibration(found, 2)
    refuse_bad_calibration(msgspec.structs.replace(found, points=60), 2)


def test_a_board_on_glass_printed_light_on_dark_is_found_from_both_sides(tmp_path: Path) -> None:
    plain = detect_board([Dataset.open(board_session(tmp_path / "plain").folder)], BOARD)
    other = detect_board([Dataset.open(board_session(tmp_path / "other", two_sided=True).folder)], BOARD)
    assert len(plain) == 16
    for (camera, instant), corners in plain.items():
        seen = other[camera, instant]
        both = sorted(corners.keys() & seen.keys())
        assert len(both) > 0.8 * len(corners)
        expected = np.array([corners[i] for i in both])
        if camera == "right":
            expected[:, 0] = WIDTH - 1 - expected[:, 0]
        away = np.linalg.norm(np.array([seen[i] for i in both]) - expected, axis=1)
        assert np.median(away) < 0.2


def test_corners_that_make_no_flat_board_are_no_board() -> None:
    places = np.asarray(BOARD.to_opencv().getChessboardCorners())[:8, :2]
    pixels = places * 900 + 40
    assert is_flat_board(places, pixels)
    assert not is_flat_board(places, pixels * (-1, 1) + (300, 0))
    pixels[3] += 40
    assert not is_flat_board(places, pixels)


def test_a_recording_without_the_board_is_refused(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    folder = tmp_path / "bare"
    shutil.copytree(boards.folder, folder)
    (folder / "calibration.json").unlink()
    refused = reconstruct("calibrate", folder, "--from", "charuco")
    assert refused.code == 3
    assert "shows the board in 0 images" in refused.complaint
    assert not (folder / "calibration.json").exists()


def test_coverage_says_what_is_missing_and_stores_nothing(tmp_path: Path, reconstruct: Reconstruct) -> None:
    session = board_session(tmp_path)
    board = "--board", "6x5", "--square-mm", 100, "--marker-mm", 75
    found = reconstruct("calibrate", session.folder, "--coverage", *board, "--json").result
    assert set(found["cameras"]) == {"left", "right"}
    assert found["cameras"]["left"]["views"] >= 5
    assert found["shared"][0]["cameras"] == ["left", "right"]
    assert any(line.startswith("move the board to the") for line in found["missing"])
    assert "missing: " in reconstruct("calibrate", session.folder, "--coverage", *board).out
    assert not (session.folder / "calibration.json").exists()


def test_columns_and_rows_mixed_up_are_told(tmp_path: Path, reconstruct: Reconstruct) -> None:
    session = board_session(tmp_path)
    board = "--board", "5x6", "--square-mm", 100, "--marker-mm", 75
    refused = reconstruct("calibrate", session.folder, "--from", "charuco", *board)
    assert refused.code == 3
    assert "shows a board of 6x5 squares, not 5x6 (--board 6x5)" in refused.complaint


def test_several_recordings_are_one(tmp_path: Path, reconstruct: Reconstruct) -> None:
    first, second = (board_session(tmp_path / name) for name in ("one", "two"))
    bare = write_session(tmp_path / "bare", Scene([]), SEEN_BY, instants=1, calibrated=False, truth=False)
    board = "--board", "6x5", "--square-mm", 100, "--marker-mm", 75
    recordings = "--recording", first.folder, "--recording", second.folder
    options = "calibrate", bare.folder, "--from", "charuco", *board, "--json"
    done = reconstruct(*options, *recordings).result
    assert done["stored"]
    assert done["source"].startswith("ChArUco board in 32 images")
    assert done["board"]["shared"][0]["views"] >= 5
