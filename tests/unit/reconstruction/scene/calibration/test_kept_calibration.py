"""A rig's calibration is kept, found again, checked against each session, and refused when a camera moved."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import Manifest
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.scene.calibration.consistency import check_rig
from reconstruction.scene.calibration.stored import (
    camera_modes,
    find_calibration,
    keep_calibration,
    shelf,
)
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.pairs import Features, detect_features
from reconstruction.scene.scene import Scene as OpenScene
from tests.unit.reconstruction.conftest import (
    Board,
    Reconstruct,
    Scene,
    make_view,
    texture,
    write_session,
)

RIG = {
    "a": make_view((-0.3, 0.0, 0.0), yaw=4),
    "b": make_view((-0.1, 0.02, 0.0), yaw=1),
    "c": make_view((0.1, -0.02, 0.0), yaw=-1),
    "d": make_view((0.3, 0.0, 0.0), yaw=-4),
}
ROOM = Scene(
    [
        Board((-9, -9, 9, 9), 4.5, texture(61)),
        Board((-1.5, 0.3, -0.6, 1.4), 3.0, texture(62)),
        Board((0.5, -0.9, 1.4, 0.1), 3.4, texture(63)),
        Board((-0.4, -1.0, 0.2, -0.3), 2.6, texture(64)),
    ]
)


def turned(view: View, *, yaw_px: float = 0.0, pitch_px: float = 0.0) -> View:
    """The view turned so that what it sees moves by so many pixels."""
    turn = cv2.Rodrigues(np.array([pitch_px, yaw_px, 0.0]) / view.focal)[0]
    return replace(view, rotation=turn @ view.rotation, translation=turn @ view.translation)


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A session of the rig without a calibration."""
    return write_session(
        tmp_path_factory.mktemp("bare"), ROOM, RIG, instants=2, calibrated=False, truth=False
    )


def calibration(views: dict[str, View], unit: str = "m") -> Calibration:
    cameras = {name: view.to_calibration() for name, view in views.items()}
    return Calibration(cameras=cameras, unit=unit, source="a board")


@pytest.fixture(scope="module")
def features(bare: Session) -> dict[str, Features]:
    """What stands still in it."""
    return {name: detect_features(Dataset(bare).grey(name, 0)) for name in RIG}


@pytest.mark.parametrize(
    ("name", "turn"), [("a", {"pitch_px": 5.0}), ("a", {"yaw_px": 6.0}), ("c", {"yaw_px": -6.0})]
)
def test_the_camera_that_moved_is_named(
    features: dict[str, Features], name: str, turn: dict[str, float]
) -> None:
    # A row of cameras: a yaw leaves every pair's epipolar lines as they were.
    moved = {**RIG, name: turned(RIG[name], **turn)}
    check = check_rig(moved, features)
    assert [camera.cameras for camera in check.moved] == [(name,)]
    assert check.moved[0].shift_px == pytest.approx(abs(sum(turn.values())), rel=0.35)
    assert not check.holds
    assert max(check.errors_px, key=lambda one: check.errors_px[one]) == name
    assert str(check).startswith(f"{name} moved: ")


def test_a_calibration_that_holds_is_not_blamed(features: dict[str, Features]) -> None:
    check = check_rig(RIG, features)
    assert check.moved == ()
    assert check.holds
    assert check.unchecked == ()
    assert check.error_px is not None
    assert check.error_px < 0.6
    pair = check_rig({name: RIG[name] for name in "ab"}, features)
    assert check.points > pair.points > 50


def test_a_camera_that_moved_keeps_the_calibration_from_being_used(
    bare: Session, capsys: pytest.CaptureFixture[str]
) -> None:
    keep_calibration(Dataset(bare), calibration({**RIG, "c": turned(RIG["c"], pitch_px=9.0)}))
    dataset = Dataset(bare)
    assert OpenScene(dataset).given is None
    said = capsys.readouterr().err
    assert "kept from boards is not used: c moved: " in said
    assert "calibrate the rig again" in said


def test_other_modes_and_other_rigs_get_none(bare: Session, tmp_path: Path) -> None:
    keep_calibration(Dataset(bare), calibration(RIG))
    other = write_session(
        tmp_path, ROOM, {"a": RIG["a"], "x": RIG["b"]}, instants=1, calibrated=False, truth=False
    )
    assert find_calibration(camera_modes(Dataset(other))) is None
    larger = change_manifest(bare, tmp_path / "larger", "width", 640)
    assert find_calibration(camera_modes(Dataset(larger))) is None
    # A camera less than the rig has is no matter.
    fewer = write_session(
        tmp_path / "fewer", ROOM, {n: RIG[n] for n in "bcd"}, instants=1, calibrated=False, truth=False
    )
    assert find_calibration(camera_modes(Dataset(fewer))) is not None


def change_manifest(session: Session, folder: Path, fact: str, value: object) -> Session:
    """A copy whose cameras say another fact of themselves."""
    shutil.copytree(session.folder, folder)
    manifest = json.loads((folder / "session.json").read_text())
    for camera in manifest["cameras"]:
        camera["facts"][fact] = value
    return Session(folder, msgspec.convert(manifest, Manifest))


def test_one_without_a_scale_does_not_replace_one_in_metres(bare: Session) -> None:
    dataset = Dataset(bare)
    keep_calibration(dataset, calibration(RIG, "arbitrary"))
    keep_calibration(dataset, calibration(RIG, "m"))
    with pytest.raises(BadInputError, match="from boards is in metres"):
        keep_calibration(dataset, calibration(RIG, "arbitrary"))
    kept = find_calibration(camera_modes(dataset))
    assert kept is not None
    assert kept.calibration.unit == "m"
    assert len(list(shelf().glob("*.json"))) == 1


def test_what_cannot_be_read_is_left_alone(bare: Session) -> None:
    keep_calibration(Dataset(bare), calibration(RIG))
    (shelf() / "broken.json").write_text("{")
    (shelf() / "other.json").write_text('{"schema_version": 9}')
    assert find_calibration(camera_modes(Dataset(bare))) is not None


def test_a_calibration_that_cannot_be_kept_is_stored_all_the_same_and_said(
    bare: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reconstruct: Reconstruct
) -> None:
    giver = write_session(tmp_path / "giver", ROOM, RIG, instants=1, truth=False)
    taker = tmp_path / "taker"
    shutil.copytree(bare.folder, taker)
    no_folder = tmp_path / "file"
    no_folder.write_text("")
    monkeypatch.setenv("XDG_DATA_HOME", str(no_folder))
    done = reconstruct("calibrate", taker, "--from", giver.folder, "--keep", "--json")
    assert done.result["stored"]
    assert not done.result["kept"]
    assert "the calibration is not kept for later sessions: cannot write " in done.err


def test_two_cameras_with_one_pose_are_refused(
    bare: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    twice = {**RIG, "b": replace(RIG["b"], rotation=RIG["a"].rotation, translation=RIG["a"].translation)}
    folder = tmp_path / "twice"
    shutil.copytree(bare.folder, folder)
    (folder / "calibration.json").write_bytes(msgspec.json.encode(calibration(twice)))
    refused = reconstruct("calibrate", folder, "--from", "session")
    assert refused.code == 3
    assert "a and b have one pose, as if they were one camera" in refused.complaint
