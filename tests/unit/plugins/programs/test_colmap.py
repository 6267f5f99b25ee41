"""COLMAP's export is read back by COLMAP itself, which also maps a sample from its pictures alone."""

from pathlib import Path
from typing import Any

import cv2  # before pycolmap
import numpy as np
import pytest

from capture_app.session.exporting.point_cloud import PointCloud, read_ply, write_ply
from capture_app.session.format.manifest import image_path
from reconstruction.methods.multiview.colmap_workspace import write_array
from tests.unit.plugins.programs.conftest import GRID, POINT, Export, Make, calibrated, spot

pycolmap: Any = None
NAMES = {image_path(c, i).removeprefix("images/") for c in ("left", "mid", "right") for i in range(4)}
KEPT = NAMES - {"rig1/right/000001.jpg", "rig1/mid/000002.jpg"}


@pytest.fixture(scope="module", autouse=True)
def _pycolmap() -> None:
    """Import it only where it is used: each of pytest's workers imports all files of tests."""
    globals()["pycolmap"] = pytest.importorskip("pycolmap")


def test_images_stay_as_they_are(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    report = export(session, "colmap")
    images = tmp_path / "out" / "images"
    assert {str(path.relative_to(images)) for path in images.rglob("*.jpg")} == KEPT
    for name in KEPT:
        assert (images / name).read_bytes() == (session.folder / "images" / name).read_bytes()
    assert any("left out: 1 image of other moments" in note for note in report.notes)


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


def export_wall(make: Make, export: Export, tmp_path: Path) -> int:
    """Export with a cloud of a wall, then a point behind it and one aside; returns the wall's points."""
    xs, ys = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.3, 0.3, 31), np.linspace(-0.2, 0.2, 21)))
    wall = np.column_stack([xs, ys, 0.05 * xs])
    behind = [POINT + np.array([0, 0, 0.5])]
    aside = [(5.0, 0.0, 0.0)]
    cloud = np.concatenate([wall, behind, aside])
    write_ply(tmp_path / "cloud.ply", PointCloud(cloud, np.full((len(cloud), 3), 90, np.uint8)))
    export(make(), "colmap", points=tmp_path / "cloud.ply")
    return len(wall)


def test_points_have_tracks_of_the_images_that_see_them(make: Make, export: Export, tmp_path: Path) -> None:
    count = export_wall(make, export, tmp_path)
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    assert len(model.points3D) == count + 2
    lengths = {number: point.track.length() for number, point in model.points3D.items()}
    assert lengths[count + 1] == lengths[count + 2] == 0
    # Ten images: a point that all cameras see is seen by each of them.
    assert max(lengths.values()) == len(KEPT)
    assert np.median(list(lengths.values())) >= 6
    for image in model.images.values():
        camera = calibrated(image.name.split("/")[1])
        for point in image.points2D:
            xyz = model.points3D[point.point3D_id].xyz
            assert point.xy == pytest.approx(np.array(spot(camera, xyz)) + 0.5, abs=1e-6)
    assert sum(len(image.points2D) for image in model.images.values()) == sum(lengths.values())


def test_fusion_of_an_export_has_points(make: Make, export: Export, tmp_path: Path) -> None:
    export_wall(make, export, tmp_path)
    out, dense = tmp_path / "out", tmp_path / "dense"
    pycolmap.undistort_images(str(dense), str(out / "sparse" / "0"), str(out / "images"))
    model = pycolmap.Reconstruction(str(dense / "sparse"))
    for image in model.images.values():
        camera, pose = model.cameras[image.camera_id], image.cam_from_world()
        rotation, normal = pose.rotation.matrix(), np.array([-0.05, 0, 1]) / np.hypot(0.05, 1)
        xs, ys = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        fx, fy, cx, cy = camera.params
        rays = np.stack([(xs - cx) / fx, (ys - cy) / fy, np.ones_like(xs)], axis=-1)
        facing = rotation @ normal
        maps = {"depth": facing @ pose.translation / (rays @ facing), "normal": 0 * rays - facing}
        for kind, values in maps.items():
            (path := dense / "stereo" / f"{kind}_maps" / f"{image.name}.geometric.bin").parent.mkdir(
                parents=True, exist_ok=True
            )
            write_array(path, values)
    pycolmap.stereo_fusion(str(tmp_path / "fused.ply"), str(dense), input_type="geometric", output_type="ply")
    assert len(read_ply(tmp_path / "fused.ply").points) > 500


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
    assert any("no calibration" in note for note in report.notes)


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
