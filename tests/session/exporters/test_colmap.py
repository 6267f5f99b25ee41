"""COLMAP's export is read back by COLMAP itself."""

from pathlib import Path

import cv2  # before pycolmap
import numpy as np
import pytest

from capture_app.session.format.manifest import image_path
from tests.session.exporters.conftest import GRID, POINT, Export, Make, calibrated, spot

pycolmap = pytest.importorskip("pycolmap")
NAMES = {image_path(c, i).removeprefix("images/") for c in ("left", "mid", "right") for i in range(4)}
KEPT = NAMES - {"rig1/right/000001.jpg", "rig1/mid/000002.jpg"}


def test_images_stay_as_they_are(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    report = export(session, "colmap")
    images = tmp_path / "out" / "images"
    assert {str(path.relative_to(images)) for path in images.rglob("*.jpg")} == KEPT
    for name in KEPT:
        assert (images / name).read_bytes() == (session.folder / "images" / name).read_bytes()
    assert any("1 images are left out" in note for note in report.notes)


def test_the_sparse_model(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(), "colmap")
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    assert len(model.rigs) == 1
    assert sorted(model.frames) == [1, 2, 3, 4]
    assert all(frame.has_pose() for frame in model.frames.values())
    assert model.num_reg_images() == len(KEPT) == len(model.images)
    assert {image.name for image in model.images.values()} == KEPT
    for image in model.images.values():
        camera = calibrated(image.name.split("/")[1])
        assert image.frame_id == int(Path(image.name).stem) + 1
        expected = -np.array(camera.rotation).T @ np.array(camera.translation)
        assert image.projection_center() == pytest.approx(expected, abs=1e-9)
        assert image.project_point(POINT) == pytest.approx(np.array(spot(camera)) + 0.5, abs=1e-6)


def test_the_rig_config_makes_frames_of_a_rig(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(), "colmap")
    out = tmp_path / "out"
    database_path = tmp_path / "database.db"
    pycolmap.Database.open(str(database_path)).close()
    pycolmap.import_images(str(database_path), str(out / "images"), pycolmap.CameraMode.PER_FOLDER)
    with pycolmap.Database.open(str(database_path)) as database:
        pycolmap.apply_rig_config(pycolmap.read_rig_config(str(out / "rig_config.json")), database)
        (rig,) = database.read_all_rigs()
        frames = database.read_all_frames()
        cameras = {camera.model.name for camera in database.read_all_cameras()}
        assert len(frames) == len(GRID)
        assert sorted(len(list(frame.data_ids)) for frame in frames) == [2, 2, 3, 3]
        assert cameras == {"PINHOLE", "OPENCV", "FULL_OPENCV"}
        left, mid = calibrated("left"), calibrated("mid")
        rotation = np.array(mid.rotation) @ np.array(left.rotation).T
        baseline = np.array(mid.translation) - rotation @ np.array(left.translation)
        poses = [pose for pose in rig.non_ref_sensors.values() if pose is not None]
        assert any(pose.translation == pytest.approx(baseline, abs=1e-12) for pose in poses)


def test_without_a_calibration_the_cameras_are_left_to_colmap(
    make: Make, export: Export, tmp_path: Path
) -> None:
    report = export(make(calibrate=()), "colmap")
    assert not (tmp_path / "out" / "sparse").exists()
    (config,) = pycolmap.read_rig_config(str(tmp_path / "out" / "rig_config.json"))
    assert [camera.image_prefix for camera in config.cameras] == ["rig1/left/", "rig1/mid/", "rig1/right/"]
    assert "no calibration" in report.notes[-1]


def test_one_ending_for_all(make: Make, export: Export, tmp_path: Path) -> None:
    session = make(suffixes={"mid": ".png"})
    export(session, "colmap")
    images = tmp_path / "out" / "images" / "rig1"
    assert {path.suffix for path in images.rglob("*.*")} == {".png"}
    original = cv2.imread(str(session.folder / "images" / "rig1" / "left" / "000000.jpg"))
    assert np.array_equal(cv2.imread(str(images / "left" / "000000.png")), original)


def test_hard_links(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    export(session, "colmap", link=True)
    name = "images/rig1/left/000000.jpg"
    assert (tmp_path / "out" / name).samefile(session.folder / name)
