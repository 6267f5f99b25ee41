"""Exports for trainers, read by COLMAP's command, pycolmap and pygltflib: 2 and 47 cameras, k3, portrait."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2  # before pycolmap
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.exporting.point_cloud import PointCloud, write_ply
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from tests.facts import make_facts

POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (1000, 3))
WIDE, PORTRAIT = (96, 64), (64, 96)
K3 = (-0.2, 0.05, 0.001, -0.001, 0.02)
RIGS = {
    "two cameras": (2, WIDE, ()),
    "47 cameras": (47, WIDE, ()),
    "portrait": (4, PORTRAIT, ()),
    "k3": (4, WIDE, K3),
    "portrait with k3": (3, PORTRAIT, K3),
}
CROPPED_PX = 0.05


def lens(number: int, count: int, size: tuple[int, int], distortion: tuple[float, ...]) -> CameraCalibration:
    """A camera on an arc around the origin, which it looks at."""
    turn = cv2.Rodrigues(np.array([0.05, 1.2 * (number / (count - 1) - 0.5), 0.02 * (number % 3)]))[0]
    rows = [(float(x), float(y), float(z)) for x, y, z in turn]
    return CameraCalibration(
        width=size[0],
        height=size[1],
        fx=80.0,
        fy=80.0,
        cx=(size[0] - 1) / 2 + 1.7,
        cy=(size[1] - 1) / 2 - 0.8,
        rotation=(rows[0], rows[1], rows[2]),
        translation=(0.0, 0.01 * (number % 2), 2.0),
        distortion=distortion or (0.0,) * 5,
    )


def build(folder: Path, rig: str) -> Session:
    count, size, distortion = RIGS[rig]
    cameras = {f"c{k:02d}": lens(k, count, size, distortion) for k in range(count)}
    writer, random = SessionWriter.create(folder, "clap"), np.random.default_rng(1)
    for name in cameras:
        noise = random.integers(0, 255, (size[1], size[0], 3)).astype(np.uint8)
        data = cv2.imencode(".png", noise)[1].tobytes()
        writer.add_image(data, camera=name, instant=0, leader_ns=10**9, suffix=".png")
    writer.set_calibration(Calibration(cameras=cameras, unit="m"))
    facts = make_facts(width=size[0], height=size[1])
    burst = BurstRecord(instants_ns=(10**9,), period_ns=33_333_333)
    return writer.finish([CameraRecord(name=name, facts=facts) for name in cameras], burst, [], "simulated")


@pytest.fixture(params=RIGS)
def exported(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Session, Path]:
    """A session and its export, with points of its own."""
    session = build(tmp_path / "sessions", request.param)
    write_ply(tmp_path / "cloud.ply", PointCloud(POINTS, np.full((1000, 3), 90, np.uint8)))
    options: dict[str, Any] = {"points": tmp_path / "cloud.ply", "on_warning": lambda note: None}
    export_session(session, "splats", tmp_path / "out", **options)
    return session, tmp_path / "out"


def true_pixels(camera: CameraCalibration) -> Any:
    """Where a lens without distortion has the points; the first pixel's centre is (0.5, 0.5)."""
    local = POINTS @ np.array(camera.rotation).T + np.array(camera.translation)
    focal, centre = (camera.fx, camera.fy), np.array([camera.cx, camera.cy])
    return local[:, :2] / local[:, 2:] * focal + centre + 0.5


def test_pycolmap_has_the_points_where_they_are(exported: tuple[Session, Path]) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    session, out = exported
    calibration = session.calibration()
    assert calibration is not None
    model = pycolmap.Reconstruction(str(out / "sparse/0"))
    assert model.num_reg_images() == len(calibration.cameras)
    assert len(model.points3D) == 1000
    for image in model.images.values():
        own = calibration.cameras[image.name.split("_")[0]]
        assert image.camera.model.name == "PINHOLE"
        shown = cv2.imread(str(out / "images" / image.name))
        assert (image.camera.width, image.camera.height) == shown.shape[1::-1]
        pixels = np.array([image.project_point(point) for point in POINTS])
        pose = image.cam_from_world().matrix()
        assert np.abs(pose[:, :3] - own.rotation).max() < 1e-6
        assert np.abs(pose[:, 3] - own.translation).max() < 1e-6
        if not any(own.distortion):  # cropped by whole pixels
            shift = pixels - true_pixels(own)
            assert np.abs(shift - np.rint(shift[0])).max() < CROPPED_PX


@pytest.mark.skipif(shutil.which("colmap") is None, reason="COLMAP's command is not installed")
def test_colmaps_command_reads_it(exported: tuple[Session, Path], tmp_path: Path) -> None:
    session, out = exported
    calibration = session.calibration()
    assert calibration is not None
    (tmp_path / "text").mkdir()
    command = ["colmap", "model_converter", "--input_path", str(out / "sparse/0"), "--output_type", "TXT"]
    environment = {"QT_QPA_PLATFORM": "offscreen", "PATH": "/usr/bin:/bin"}
    subprocess.run(
        [*command, "--output_path", str(tmp_path / "text")], check=True, capture_output=True, env=environment
    )
    cameras, images, points = (
        [line for line in (tmp_path / f"text/{name}.txt").read_text().splitlines() if line[:1] != "#"]
        for name in ("cameras", "images", "points3D")
    )
    assert {line.split()[1] for line in cameras} == {"PINHOLE"}
    assert len(points) == 1000
    by_camera = {line.split()[-1].split("_")[0]: line for line in images[::2]}
    assert by_camera.keys() == calibration.cameras.keys()
    for name, line in by_camera.items():
        own = calibration.cameras[name]
        w, *v = map(float, line.split()[1:5])
        turn = cv2.Rodrigues(2 * np.arctan2(np.linalg.norm(v), w) * np.array(v) / np.linalg.norm(v))[0]
        assert np.abs(turn - own.rotation).max() < 1e-6


def test_a_gltf_library_has_the_cameras(exported: tuple[Session, Path]) -> None:
    pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is not installed")
    session, out = exported
    calibration = session.calibration()
    assert calibration is not None
    content = pygltflib.GLTF2().load(str(out / "cameras.gltf"))
    nodes = [node for node in content.nodes if node.camera is not None]
    assert [node.name for node in nodes] == list(calibration.cameras)
    assert {camera.type for camera in content.cameras} == {"perspective"}
    assert content.accessors[0].count == 1000
    assert json.loads((out / "cameras.gltf").read_text())["asset"]["version"] == "2.0"


@pytest.mark.parametrize(("rig", "points"), [("two cameras", True), ("two cameras", False), ("k3", True)])
def test_an_export_to_colmap_says_that_trainers_cannot_read_it(
    rig: str, points: bool, tmp_path: Path
) -> None:
    """3DGS looks for images by the last part of their names; gsplat fails without points, and with k3."""
    write_ply(tmp_path / "cloud.ply", PointCloud(POINTS, np.full((1000, 3), 90, np.uint8)))
    given: dict[str, Any] = {"points": tmp_path / "cloud.ply"} if points else {}
    notes = export_session(build(tmp_path / "s", rig), "colmap", tmp_path / "out", **given).notes
    assert notes == ["sparse/0 is for COLMAP: trainers of Gaussian splats need --to splats"]
