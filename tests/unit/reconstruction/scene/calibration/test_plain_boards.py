"""Plain checkerboards, recordings for lenses alone, and a world whose ground and upward direction are set."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.board.boards import MIN_CORNERS, CharucoBoard, Checkerboard, squares_seen
from capture_app.board.detector import Board, BoardDetector
from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.common.geometry import Array, View
from reconstruction.scene import calibration_run
from reconstruction.scene.calibration.board_calibration import detect_board
from reconstruction.scene.calibration.soundness import calibrated_views
from reconstruction.scene.calibration.world import in_world, world_of_board, world_of_marks
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import Reconstruct, add_image, finish_session, make_view

PLAIN = Checkerboard(10, 7, 0.06)
MARKED = CharucoBoard(5, 4, 0.16, 0.12, "4X4_50")
TEXEL_PX = 40


LEFT, RIGHT = make_view((-0.15, 0, 0), yaw=4.0), make_view((0.15, 0.01, 0), yaw=-4.0)


def picture(view: View, board: Board, turn: Array, middle: Array) -> Array:
    """What a camera sees of a board whose middle is there and which is turned so (rig_from_board)."""
    if isinstance(board, Checkerboard):
        paint, margin = board.picture(TEXEL_PX), 1
    else:
        paint = np.pad(board.picture(TEXEL_PX), TEXEL_PX, constant_values=255)
        margin = 1
    size = np.array([board.across + 2 * margin, board.down + 2 * margin, 0]) * board.square_m / 2
    corner = middle - turn @ size
    into = view.matrix @ view.rotation @ np.column_stack([turn[:, 0], turn[:, 1], corner])
    into[:, 2] += view.matrix @ view.translation
    texel = board.square_m / TEXEL_PX
    metres = np.array([[texel, 0, texel / 2], [0, texel, texel / 2], [0, 0, 1]])
    # Painted four times as large and made smaller, for edges as a camera sees them.
    grown = np.diag([4.0, 4.0, 1.0]) @ np.array([[1, 0, 0.375], [0, 1, 0.375], [0, 0, 1.0]])
    large = cv2.warpPerspective(
        paint, grown @ into @ metres, (4 * view.width, 4 * view.height), borderValue=(190.0,)
    )
    return np.asarray(cv2.resize(large, (view.width, view.height), interpolation=cv2.INTER_AREA))


def pixels(view: View, board: Board, turn: Array, middle: Array) -> Array:
    """Where the inner corners truly are in that picture."""
    half = np.array([board.across, board.down, 0]) * board.square_m / 2
    points = (board.places - half) @ turn.T + middle
    return view.project(points @ view.rotation.T + view.translation)


def held(k: int, near: float = 1.0) -> tuple[Array, Array]:
    """How the board is held at moment k; `near`: the distance against the usual one."""
    angles = np.radians([28 * np.sin(2.1 * k), 32 * np.cos(1.3 * k), 7 * k])
    return cv2.Rodrigues(angles)[0], np.array(
        [0.1 * np.sin(k), 0.08 * np.cos(2 * k), near * (1.3 + 0.08 * (k % 3))]
    )


@pytest.mark.parametrize("angle", range(0, 360, 45))
def test_corners_are_numbered_however_the_board_is_turned(angle: int) -> None:
    turn = cv2.Rodrigues(np.radians([12.0, 0, 0]))[0] @ cv2.Rodrigues(np.radians([0, 0, float(angle)]))[0]
    middle = np.array([0.0, 0.0, 1.2])
    found = BoardDetector(PLAIN).detect(picture(LEFT, PLAIN, turn, middle))
    assert sorted(found) == list(range(PLAIN.corners))
    at = np.array([found[number] for number in range(PLAIN.corners)])
    assert np.abs(at - pixels(LEFT, PLAIN, turn, middle)).max() < 0.3


def test_a_board_that_looks_the_same_upside_down_is_read_from_its_upper_left() -> None:
    board = Checkerboard(9, 7, 0.06)
    assert board.is_ambiguous
    for angle in (-40.0, 0.0, 40.0):
        turn, middle = cv2.Rodrigues(np.radians([0, 0, angle]))[0], np.array([0.0, 0.0, 1.2])
        found = BoardDetector(board).detect(picture(LEFT, board, turn, middle))
        at = np.array([found[number] for number in range(board.corners)])
        assert np.abs(at - pixels(LEFT, board, turn, middle)).max() < 0.3


@pytest.mark.parametrize("shape", [(3, 7), (8, 8)])
def test_boards_whose_corners_cannot_be_numbered_are_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(BadInputError, match=f"{shape[0]}x{shape[1]}"):
        Checkerboard(*shape, 0.03)


# The ground

FLOOR = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]) @ cv2.Rodrigues(np.array([0, 0, 0.4]))[0]
"""A board on the floor, y down in the rig: its right is the rig's, turned a little, its z into the floor."""
HEIGHT_M = 1.1
LARGE = Checkerboard(10, 7, 0.1)


def floor_session(root: Path, board: Board) -> tuple[Session, dict[str, View]]:
    """Cameras that look down at a board which lies 1.1 m below them."""
    down = cv2.Rodrigues(np.radians([38.0, 0, 0]))[0]
    rig = {"left": LEFT, "right": RIGHT}
    views = {name: replace(view, rotation=view.rotation @ down) for name, view in rig.items()}
    writer = SessionWriter.create(root, "floor")
    for k in range(3):
        for name, view in views.items():
            add_image(writer, name, k, picture(view, board, FLOOR, np.array([0.0, HEIGHT_M, 1.4])))
    return finish_session(writer, views, 3), views


def shrunk(views: Mapping[str, View], unit: float) -> Calibration:
    """The calibration of these cameras, its lengths in units of so many metres."""
    cameras = {}
    for name, view in views.items():
        camera = view.to_calibration()
        translation = tuple(value / unit for value in camera.translation)
        cameras[name] = msgspec.structs.replace(camera, translation=translation)
    return Calibration(cameras=cameras, unit="m" if unit == 1.0 else "arbitrary", source="COLMAP")


def check_floor(found: Calibration, views: Mapping[str, View], board: Board) -> None:
    half = np.array([board.across, board.down, 0]) * board.square_m / 2
    corner = np.array([0.0, HEIGHT_M, 1.4]) - FLOOR @ half
    into = np.diag([1.0, -1.0, -1.0]) @ FLOOR.T
    assert found.unit == "m"
    for name, view in views.items():
        rotation = np.array(found.cameras[name].rotation)
        assert rotation == pytest.approx(view.rotation @ into.T, abs=0.01)
        centre = -rotation.T @ np.array(found.cameras[name].translation)
        assert centre == pytest.approx(into @ (view.centre - corner), abs=0.04)
        assert centre[2] == pytest.approx(HEIGHT_M, abs=0.04)


@pytest.mark.parametrize("unit", [1.0, 2.5])
@pytest.mark.parametrize("board", [LARGE, MARKED], ids=["plain", "with markers"])
def test_a_board_on_the_floor_says_where_up_is(tmp_path: Path, board: Board, unit: float) -> None:
    session, views = floor_session(tmp_path, board)
    calibration = shrunk(views, unit)
    dataset = Dataset.open(session.folder)
    known = calibrated_views(dataset, calibration)
    corners = detect_board([dataset], board)
    world, times = world_of_board(known, board, corners, metric=unit == 1.0)
    assert times == 3
    check_floor(in_world(calibration, world, "m", "a board"), views, board)
    if unit == 1.0:  # one camera is enough
        alone = {key: found for key, found in corners.items() if key[0] == "left"}
        world, _ = world_of_board(known, board, alone, metric=True)
        check_floor(in_world(calibration, world, "m", "a board"), views, board)


def test_a_board_that_does_not_lie_or_is_seen_from_below_is_no_floor(tmp_path: Path) -> None:
    session, views = floor_session(tmp_path, LARGE)
    corners = detect_board([Dataset.open(session.folder)], LARGE)
    moved = {key: found for key, found in corners.items() if key[1] == 0}
    for name, view in views.items():
        moved[name, 1] = dict(enumerate(pixels(view, LARGE, *held(1))))
    with pytest.raises(BadInputError, match="on the ground moves"):
        world_of_board(views, LARGE, moved, metric=True)
    unknown = {("other", moment): found for (_, moment), found in corners.items()}
    for unseen in ({}, unknown):
        with pytest.raises(BadInputError, match="no two cameras see the board well enough"):
            world_of_board(views, LARGE, unseen, metric=True)
    few = {key: dict(sorted(found.items())[: MIN_CORNERS - 1]) for key, found in corners.items()}
    bend = {"left": np.array([40.0, 0.0]), "right": np.zeros(2)}
    bent = {key: {n: at + n % 2 * bend[key[0]] for n, at in found.items()} for key, found in corners.items()}
    for unfit in (few, bent):
        with pytest.raises(BadInputError, match="no two cameras see the board well enough"):
            world_of_board(views, LARGE, unfit, metric=False)
    ceiling = {}
    width = LARGE.across - 1
    for key, found in corners.items():  # left and right exchanged: as its back would be numbered
        grid = np.array([found[number] for number in range(LARGE.corners)]).reshape(-1, width, 2)
        ceiling[key] = dict(enumerate(grid[:, ::-1].reshape(-1, 2)))
    with pytest.raises(BadInputError, match="seen from below"):
        world_of_board(views, LARGE, ceiling, metric=True)


def test_two_points_one_above_the_other_say_where_up_is() -> None:
    foot, head = np.array([0.2, 1.1, 2.0]), np.array([0.2, -0.4, 2.0])
    views = {"left": LEFT, "right": RIGHT}

    def seen(view: View) -> tuple[tuple[float, float], tuple[float, float]]:
        first, second = view.project(np.array([foot, head]) @ view.rotation.T + view.translation).tolist()
        return (first[0], first[1]), (second[0], second[1])

    world = world_of_marks(views, {name: seen(view) for name, view in views.items()})
    cameras = {name: view.to_calibration() for name, view in views.items()}
    found = in_world(Calibration(cameras=cameras, source="COLMAP"), world, "m", "two points")
    assert found.unit == "m"
    for name, view in views.items():
        rotation, translation = np.array(found.cameras[name].rotation), found.cameras[name].translation
        centre, level = -rotation.T @ translation, view.centre - foot
        assert centre[2] == pytest.approx(-level[1], abs=1e-3)
        assert np.hypot(centre[0], centre[1]) == pytest.approx(np.hypot(level[0], level[2]), abs=1e-3)
        if name == "left":
            assert rotation[2][0] == pytest.approx(0, abs=1e-6)  # it looks along y
            assert rotation[2][1] > 0.9
        # The upper point is seen where it was.
        there = rotation @ np.array([0, 0, 1.5]) + translation
        assert view.project(there[None]) == pytest.approx(np.array([seen(view)[1]]), abs=1e-3)


def test_what_is_said_of_marks_and_grounds(tmp_path: Path, reconstruct: Reconstruct) -> None:
    session, _ = floor_session(tmp_path, LARGE)
    arguments = "calibrate", session.folder, "--from", "session", "--replace"
    mark = "--mark", "left=1,2,3,4"
    assert "--mark needs --distance-m or --vertical" in reconstruct(*arguments, *mark).complaint
    assert "--vertical needs --mark" in reconstruct(*arguments, "--vertical").complaint
    both = reconstruct(*arguments, *mark, "--vertical", "--ground", session.folder).complaint
    assert "--ground does not work with --vertical: both define the ground" in both


@pytest.mark.parametrize("shape", [(9, 7), (10, 7)])
def test_that_a_board_looks_the_same_upside_down_is_said(
    shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    by_board = Calibration(cameras={}, unit="m", source="a board")
    monkeypatch.setattr(calibration_run, "detect_board", lambda *_: {("a", 0): {}})
    monkeypatch.setattr(calibration_run, "calibrate_from_board", lambda *_: (by_board, {}))
    for name in ("shared_corners", "count_coverage"):
        monkeypatch.setattr(calibration_run, name, lambda *_: None)
    options = calibration_run.CalibrateOptions(board=Checkerboard(*shape, 0.06))
    dataset: Any = SimpleNamespace(cameras=())
    calibration_run._from_board(dataset, options)
    assert ("a checkerboard of 9x7 squares looks the same" in capsys.readouterr().err) == (shape == (9, 7))


def test_a_board_of_another_size_is_named(tmp_path: Path, reconstruct: Reconstruct) -> None:
    writer = SessionWriter.create(tmp_path, "other")
    for k in range(2):
        for name, view in (("left", LEFT), ("right", RIGHT)):
            add_image(writer, name, k, picture(view, Checkerboard(9, 8, 0.06), *held(k)))
    session = finish_session(writer, {"left": LEFT, "right": RIGHT}, 2)
    asked = "--from", "board", "--board", "10x7", "--square-mm", 60, "--dictionary", "none"
    refused = reconstruct("calibrate", session.folder, *asked)
    assert refused.code == 3
    assert (
        "show a board without markers of 9x8 squares, not 10x7 (--dictionary none --board 9x8)"
        in refused.complaint
    )


def test_a_board_that_looks_the_same_from_all_sides_is_seen_too() -> None:
    rows, columns = np.mgrid[:8, :8]
    squares = np.pad((rows + columns) % 2, 1, constant_values=1)
    grey = np.kron(squares, np.full((30, 30), 230)).astype(np.uint8) + np.uint8(10)
    assert squares_seen(grey) == (8, 8)
    assert squares_seen(np.full((240, 320), 120, np.uint8)) is None
