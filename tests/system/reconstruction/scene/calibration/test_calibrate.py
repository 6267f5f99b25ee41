"""`reconstruct calibrate`: judged, refused with a reason, stored once."""

import shutil
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View, other_from_reference
from tests.imported import import_one
from tests.unit.reconstruction.conftest import (
    VIEWS,
    Reconstruct,
    make_view,
)


def test_a_good_calibration_is_reported_and_another_rig_s_is_refused(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    quality = reconstruct("calibrate", boards.folder, "--from", "session", "--json").result["quality"]
    # The boards are painted alike in many places, so some points are matched wrongly.
    assert quality["inlier_share"] > 0.5
    assert quality["reprojection_error_px"] < 1
    assert set(quality["coverage"]) == set(VIEWS)

    folder = tmp_path / "moved"
    shutil.copytree(boards.folder, folder)
    own = boards.calibration()
    assert own is not None
    other = make_view((0.1, 0.01, 0.0), yaw=-1.5, pitch=4.0, roll=9.0)
    turned = tuple(tuple(float(v) for v in row) for row in other.rotation)
    wrong = msgspec.structs.replace(own.cameras["right"], rotation=turned)
    broken = msgspec.structs.replace(own, cameras={**own.cameras, "right": wrong})
    (folder / "calibration.json").write_bytes(msgspec.json.encode(broken))
    refused = reconstruct("calibrate", folder, "--from", "session")
    assert refused.code == 3
    assert "not good enough: only" in refused.complaint
    assert len(refused.err.splitlines()) == 1


@pytest.mark.shared
def test_webcams_all_around_a_real_board_are_calibrated_as_their_owner_did(
    shared: Path, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    folder = shared / "footage" / "caliscope_4cam"
    recording = folder / "calibration" / "extrinsic"
    options = ImportOptions(
        timestamps=[("", recording / "timestamps.csv")],
        every=4,
        calibration=(str(folder / "camera_array.toml"),),
    )
    session = import_one([str(recording)], tmp_path, "board", options)
    theirs = session.calibration()
    assert theirs is not None
    # White on black, on glass; cam_1 sees it from behind.
    board = "--board", "4x5", "--square-mm", 54, "--marker-mm", 40.5, "--dictionary", "4X4_1000"
    done = reconstruct("calibrate", session.folder, "--from", "charuco", *board, "--replace", "--json")
    quality = done.result["quality"]
    assert quality["inlier_share"] > 0.98
    assert quality["reprojection_error_px"] < 0.5
    ours = Session.open(session.folder).calibration()
    assert ours is not None
    for name in ("cam_1", "cam_2", "cam_3"):
        places = []
        for found in (ours, theirs):
            a, b = (View.from_calibration(found.cameras[n], 1280, 720) for n in ("cam_0", name))
            places.append(other_from_reference(a, b))
        # Theirs rests on a recording for each lens, ours on this one alone.
        assert np.degrees(np.linalg.norm(cv2.Rodrigues(places[0][0] @ places[1][0].T)[0])) < 4
        far = [float(np.linalg.norm(translation)) for _, translation in places]
        assert far[0] == pytest.approx(far[1], rel=0.08)


def test_calibrations_of_other_programs_are_taken(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    export_session(boards, "colmap", tmp_path / "colmap")
    export_session(boards, "nerfstudio", tmp_path / "nerfstudio")
    known = boards.calibration()
    assert known is not None
    for path in ("colmap/sparse/0", "nerfstudio/transforms.json"):
        folder = tmp_path / path.partition("/")[0] / "session"
        shutil.copytree(boards.folder, folder)
        (folder / "calibration.json").unlink()
        done = reconstruct("calibrate", folder, "--from", tmp_path / path, "--json").result
        assert done["stored"]
        found = Session.open(folder).calibration()
        assert found is not None
        for name, camera in known.cameras.items():
            assert found.cameras[name].fx == pytest.approx(camera.fx)
            assert np.array(found.cameras[name].rotation) == pytest.approx(
                np.array(camera.rotation), abs=1e-9
            )
            assert found.cameras[name].translation == pytest.approx(camera.translation, abs=1e-9)
