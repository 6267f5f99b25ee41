"""Plain checkerboards, recordings for lenses alone, and a world whose ground and upward direction are set."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.board.detector import Board
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.common.geometry import View
from tests.unit.reconstruction.conftest import Reconstruct, add_image, finish_session
from tests.unit.reconstruction.scene.calibration.test_plain_boards import (
    HEIGHT_M,
    LARGE,
    LEFT,
    PLAIN,
    RIGHT,
    floor_session,
    held,
    picture,
)

OPTIONS = ("--board", "10x7", "--square-mm", 60, "--dictionary", "none")


def turned(view: View, roll_deg: float) -> View:
    """The same camera, rolled about its axis."""
    roll = cv2.Rodrigues(np.radians([0.0, 0.0, roll_deg]))[0]
    return replace(view, rotation=roll @ view.rotation, translation=roll @ view.translation)


RIG = {"left": LEFT, "right": turned(RIGHT, 180.0)}


def record(
    root: Path, name: str, views: Mapping[str, View], board: Board, moments: range, near: float = 1.0
) -> Session:
    """A session in which all these cameras see the board at each moment."""
    writer = SessionWriter.create(root, name)
    for k in moments:
        for camera, view in views.items():
            add_image(writer, camera, k - moments.start, picture(view, board, *held(k, near)))
    return finish_session(writer, views, len(moments))


def test_a_rig_with_one_camera_upside_down(tmp_path: Path, reconstruct: Reconstruct) -> None:
    session = record(tmp_path, "board", RIG, PLAIN, range(12))
    done = reconstruct("calibrate", session.folder, "--from", "board", *OPTIONS, "--json").result
    assert done["quality"]["reprojection_error_px"] < 0.3
    found = Session.open(session.folder).calibration()
    assert found is not None
    assert found.source.startswith("checkerboard in 24 images")
    between = np.array(found.cameras["right"].rotation)
    assert between == pytest.approx(RIG["right"].rotation @ LEFT.rotation.T, abs=0.01)
    place = -between.T @ np.array(found.cameras["right"].translation)
    assert np.linalg.norm(place) == pytest.approx(np.linalg.norm(LEFT.centre - RIGHT.centre), rel=0.02)


def test_lenses_have_recordings_of_their_own(tmp_path: Path, reconstruct: Reconstruct) -> None:
    session = record(tmp_path, "rig", RIG, PLAIN, range(5))
    alone = [
        record(tmp_path, f"lens-{n}", {n: view}, PLAIN, range(20, 45), 0.75).folder for n, view in RIG.items()
    ]
    arguments = ["calibrate", session.folder, "--from", "board", *OPTIONS, "--replace"]
    errors, source = [], ""
    for recordings in ([], [part for folder in alone for part in ("--lens-recording", folder)]):
        reconstruct(*arguments, *recordings)
        found = Session.open(session.folder).calibration()
        assert found is not None
        source = found.source
        errors.append(max(abs(camera.fx - LEFT.matrix[0, 0]) for camera in found.cameras.values()))
    assert "lenses of left, right from recordings of their own" in source
    assert errors[1] < 2.5 < errors[0], errors
    other = record(tmp_path, "other", {"top": LEFT}, PLAIN, range(1))
    refused = reconstruct(*arguments, "--lens-recording", other.folder).complaint
    assert "was taken by other cameras (top)" in refused


def test_the_rig_and_the_floor_are_calibrated_at_once(tmp_path: Path, reconstruct: Reconstruct) -> None:
    floor, _ = floor_session(tmp_path, LARGE)
    shown = record(tmp_path, "shown", {"left": LEFT, "right": RIGHT}, LARGE, range(12), 1.5)
    arguments = (
        "calibrate",
        floor.folder,
        "--from",
        "board",
        "--recording",
        shown.folder,
        *OPTIONS,
        "--square-mm",
        100,
    )
    done = reconstruct(*arguments, "--ground", floor.folder, "--json").result
    assert done["kept"]
    assert "z up, ground by a board on it in floor, at 3 instants" in done["source"]
    found = Session.open(floor.folder).calibration()
    assert found is not None
    for camera in found.cameras.values():
        rotation = np.array(camera.rotation)
        assert (-rotation.T @ np.array(camera.translation))[2] == pytest.approx(HEIGHT_M, abs=0.05)
        assert rotation[2] @ [0, 0, 1] == pytest.approx(-np.sin(np.radians(38)), abs=0.05)
