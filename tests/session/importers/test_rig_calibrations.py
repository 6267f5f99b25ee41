"""Calibrations that hold a whole rig mean here what their programs mean by them, by those programs' formulas.

EasyMocap: easymocap/mytools/camera_utils.py, write_camera and read_camera (P = K [R | T]). COLMAP: its own
library writes the models, and docs colmap.github.io/format.html, rigs.html. nerfstudio: "Nerfstudio dataset
format" on docs.nerf.studio and cameras/cameras.py (rays through pixel centres at + 0.5). OpenCap:
opencap-core's utilsChecker.py, calcIntrinsics and calcExtrinsics.
"""

import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2  # before pycolmap
import msgspec
import numpy as np
import pytest

from capture_app.errors import BadInputError
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.importers.calibrations.reading import fit_calibration, read_views

pycolmap = pytest.importorskip("pycolmap")
SIZE = (640, 480)
D = np.array([-0.12, 0.03, 0.002, -0.001, 0.0])
POINTS = np.array([[0.1, -0.2, 3.0], [-0.4, 0.3, 2.5], [0.6, 0.1, 4.0]])
Array = np.ndarray[Any, Any]


def lens(n: int) -> Array:
    return np.array([[600.0 + n, 0, 330.25], [0, 610.0 + n, 235.5], [0, 0, 1]])


def pose(n: int) -> tuple[Array, Array]:
    return cv2.Rodrigues(np.array([0.1 * n, -0.2 * n, 0.05]))[0], np.array([-0.3 * n, 0.02, 0.1 * n])


def read(*paths: Path, names: tuple[str, ...] = ("cam0", "cam1"), **options: Any) -> Calibration:
    sizes = dict.fromkeys(names, SIZE)
    return fit_calibration(read_views([("", path) for path in paths], names), sizes, **options)


def see(camera: CameraCalibration) -> Array:
    """Where this calibration has the points, in pixels whose first has its centre at (0, 0)."""
    rotation = cv2.Rodrigues(np.array(camera.rotation))[0]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    pixels, _ = cv2.projectPoints(
        POINTS, rotation, np.array(camera.translation), matrix, np.array(camera.distortion)
    )
    return np.asarray(pixels).reshape(-1, 2)


# EasyMocap


def easymocap(folder: Path) -> Path:
    """The two files as write_camera makes them: six decimals, lines that end as on Windows."""

    def matrix(key: str, value: Array) -> list[str]:
        data = ", ".join(f"{x:.6f}" for x in value.ravel())
        head = [f"{key}: !!opencv-matrix", f"  rows: {value.shape[0]}", f"  cols: {value.shape[1]}"]
        return [*head, "  dt: d", f"  data: [{data}]"]

    folder.mkdir(parents=True)
    names = ["names:", '  - "01"', '  - "02"']
    intri, extri = ["%YAML:1.0", "---", *names], ["%YAML:1.0", "---", *names]
    for n, name in enumerate(("01", "02")):
        rotation, translation = pose(n)
        intri += matrix(f"K_{name}", lens(n)) + matrix(f"dist_{name}", D[None])
        intri += [f"H_{name}: {SIZE[1]}", f"W_{name}: {SIZE[0]}"]
        extri += matrix(f"R_{name}", cv2.Rodrigues(rotation)[0]) + matrix(f"Rot_{name}", rotation)
        extri += matrix(f"T_{name}", translation[:, None])
    for file, lines in (("intri.yml", intri), ("extri.yml", extri)):
        (folder / file).write_bytes("".join(f"{line}\r\n" for line in lines).encode())
    return folder


@pytest.mark.parametrize("file", ["", "intri.yml"])
def test_easymocap(tmp_path: Path, file: str) -> None:
    found = read(easymocap(tmp_path / "cal") / file, names=("01", "02"))
    assert found.unit == "m"
    for n, name in enumerate(("01", "02")):
        rotation, translation = pose(n)
        expected, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(rotation)[0], translation, lens(n), D)
        np.testing.assert_allclose(see(found.cameras[name]), expected.reshape(-1, 2), atol=2e-3)
    (tmp_path / "cal" / "extri.yml").unlink()
    with pytest.raises(BadInputError, match=r"no extri\.yml"):
        read(tmp_path / "cal", names=("01", "02"))


# COLMAP


def colmap(folder: Path, *, text: bool, frames: int = 2, wander: float = 0.0, model: str = "OPENCV") -> Path:
    """A model written by COLMAP: a rig of two cameras, `frames` instants; it moves by `wander` a frame."""
    found = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    for n in range(2):
        matrix = lens(n)
        parameters = [matrix[0, 0], matrix[1, 1], matrix[0, 2] + 0.5, matrix[1, 2] + 0.5, *D[:4]]
        camera = pycolmap.Camera(
            camera_id=n + 1, model=model, width=SIZE[0], height=SIZE[1], params=parameters
        )
        found.add_camera(camera)
        sensor = camera.sensor_id
        if n == 0:
            rig.add_ref_sensor(sensor)
        else:
            rotation, translation = pose(n)
            first, origin = pose(0)
            between = rotation @ first.T
            moved = pycolmap.Rigid3d(pycolmap.Rotation3d(between), translation - between @ origin)
            rig.add_sensor(sensor, moved)
    found.add_rig(rig)
    for k in range(frames):
        rotation, translation = pose(0)
        frame = pycolmap.Frame(frame_id=k + 1, rig_id=1)
        frame.rig_from_world = pycolmap.Rigid3d(
            pycolmap.Rotation3d(rotation), translation + np.array([wander * k, 0, 0])
        )
        for n in range(2):
            frame.add_data_id(pycolmap.data_t(found.cameras[n + 1].sensor_id, 2 * k + n + 1))
        found.add_frame(frame)
        for n in range(2):
            name = f"rig1/cam{n}/{k:06d}.jpg"
            image = pycolmap.Image(name=name, camera_id=n + 1, image_id=2 * k + n + 1)
            image.frame_id = k + 1
            found.add_image(image)
    folder.mkdir(parents=True)
    write = found.write_text if text else found.write_binary
    write(str(folder))
    return folder


@pytest.mark.parametrize("text", [True, False])
def test_colmaps_models(tmp_path: Path, text: bool) -> None:
    colmap(tmp_path / "sparse" / "0", text=text)
    found = read(tmp_path)
    assert found.unit == "arbitrary"
    assert read(tmp_path, unit="m").unit == "m"
    model = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    for image in model.images.values():
        camera = found.cameras[image.name.split("/")[1]]
        expected = [image.project_point(point) for point in POINTS]
        np.testing.assert_allclose(see(camera) + 0.5, expected, atol=1e-6)


@pytest.mark.parametrize("text", [True, False])
def test_a_rig_that_colmap_lets_move_is_read_in_its_own_coordinates(tmp_path: Path, text: bool) -> None:
    """Each instant has its own pose then, and its sensors theirs to each other."""
    still, moving = (read(colmap(tmp_path / f"{w}", text=text, wander=w)).cameras for w in (0.0, 0.01))
    np.testing.assert_allclose(moving["cam0"].rotation, np.eye(3), atol=1e-12)
    between = np.array(still["cam1"].rotation) @ np.array(still["cam0"].rotation).T
    np.testing.assert_allclose(moving["cam1"].rotation, between, atol=1e-12)


def test_colmaps_models_without_a_rig(tmp_path: Path) -> None:
    """As COLMAP up to 3.11 writes them: one image a camera, in no folder; or a camera that moves."""
    quaternion = "0.9998477 0.0174524 0 0"
    (tmp_path / "cameras.txt").write_text("# Camera list\n1 SIMPLE_RADIAL 640 480 600 320 240 0.01\n")
    lines = [f"1 {quaternion} 0 0 0 1 cam0.jpg", "", f"2 {quaternion} 1 0 0 1 cam1.jpg", "1.0 2.0 -1"]
    (tmp_path / "images.txt").write_text("\n".join(["# Image list", *lines, ""]))
    camera = read(tmp_path).cameras["cam1"]
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (600, 600, 319.5, 239.5)
    assert list(camera.distortion) == [0.01, 0, 0, 0, 0]
    assert list(camera.translation) == [1, 0, 0]
    text = (tmp_path / "images.txt").read_text()
    (tmp_path / "images.txt").write_text(text.replace("cam1.jpg", "x/cam0/2.jpg"))
    with pytest.raises(BadInputError, match="cam0 is not in one place"):
        read(tmp_path)


def test_rig_config(tmp_path: Path) -> None:
    rotation, translation = pose(1)
    quaternion = pycolmap.Rotation3d(rotation).quat[[3, 0, 1, 2]].tolist()
    parameters = [600.0, 610.0, 330.75, 236.0, *D[:4].tolist()]
    known = {"camera_model_name": "OPENCV", "camera_params": parameters}
    sensors = [
        {"image_prefix": "rig1/cam0/", "ref_sensor": True, **known},
        {
            "image_prefix": "rig1/cam1/",
            "cam_from_rig_rotation": quaternion,
            "cam_from_rig_translation": translation.tolist(),
            **known,
        },
    ]
    path = tmp_path / "rig_config.json"
    path.write_text(json.dumps([{"cameras": sensors}]))
    assert pycolmap.read_rig_config(str(path))
    expected, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(rotation)[0], translation, lens(0), D)
    np.testing.assert_allclose(see(read(path).cameras["cam1"]), expected.reshape(-1, 2), atol=1e-6)
    del sensors[1]["cam_from_rig_rotation"]
    path.write_text(json.dumps([{"cameras": sensors}]))
    with pytest.raises(BadInputError, match="cam1 has no cam_from_rig"):
        read(path)


# nerfstudio


def transforms(path: Path, **change: Any) -> Path:
    frames = []
    for k in range(2):
        for n in range(2):
            rotation, translation = pose(n)
            world = np.eye(4)
            world[:3, :3], world[:3, 3] = rotation.T, -rotation.T @ translation
            world[:, 1:3] *= -1
            frame = {"file_path": f"images/cam{n}/{k:04d}.png", "transform_matrix": world.tolist()}
            frames.append({**frame, "fl_x": lens(n)[0, 0], "fl_y": lens(n)[1, 1], **change})
    of_all = {"camera_model": "OPENCV", "w": SIZE[0], "h": SIZE[1], "cx": 330.75, "cy": 236.0}
    of_all |= {"k1": D[0], "k2": D[1], "p1": D[2], "p2": D[3]}
    path.write_text(json.dumps({**of_all, "frames": frames}))
    return path


def test_nerfstudios_transforms(tmp_path: Path) -> None:
    """A ray of nerfstudio's leaves the pixel at ((x - cx) / fl_x, -(y - cy) / fl_y, -1) in the camera."""
    path = transforms(tmp_path / "transforms.json")
    found = read(tmp_path)
    assert found.unit == "arbitrary"
    frames = json.loads(path.read_text())["frames"]
    for n, name in enumerate(("cam0", "cam1")):
        camera = msgspec.structs.replace(found.cameras[name], distortion=(0.0,) * 5)
        world = np.array(frames[n]["transform_matrix"])
        for point, (x, y) in zip(POINTS, see(camera) + 0.5, strict=True):
            ray = np.array([(x - 330.75) / frames[n]["fl_x"], -(y - 236.0) / frames[n]["fl_y"], -1])
            towards, away = world[:3, :3] @ ray, point - world[:3, 3]
            assert np.linalg.norm(np.cross(towards, away)) < 1e-9
            assert towards @ away > 0
        np.testing.assert_allclose(found.cameras[name].distortion, D)


def test_nerfstudios_transforms_that_no_rig_of_ours_has(tmp_path: Path) -> None:
    path = transforms(tmp_path / "transforms.json", camera_model="OPENCV_FISHEYE")
    with pytest.raises(BadInputError, match="OPENCV_FISHEYE"):
        read(path)
    with pytest.raises(BadInputError, match="no number fl_x"):
        read(transforms(path, fl_x=None))
    content = json.loads(transforms(path).read_text())
    content["frames"][2]["transform_matrix"][0][3] += 0.1
    path.write_text(json.dumps(content))
    with pytest.raises(BadInputError, match="cam0 is not in one place"):
        read(path)
    content["frames"][0] = {"file_path": "images/cam0/0.png", "transform_matrix": "there"}
    path.write_text(json.dumps(content))
    with pytest.raises(BadInputError, match="not made of numbers"):
        read(path)


def test_the_field_of_view_of_older_transforms(tmp_path: Path) -> None:
    content = {"camera_angle_x": 2 * np.arctan(320 / 500), "w": 640, "h": 480}
    frames = [{"file_path": f"./cam{n}.png", "transform_matrix": np.eye(4).tolist()} for n in range(2)]
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({**content, "frames": frames}))
    camera = read(path).cameras["cam0"]
    assert (camera.fx, camera.fy) == pytest.approx((500, 500))
    assert (camera.cx, camera.cy) == (319.5, 239.5)


# OpenCap


def opencap(videos: Path, protocol: int = 4, **change: Any) -> Path:
    for n in range(2):
        rotation, translation = pose(n)
        content = {
            "distortion": D[None],
            "intrinsicMat": lens(n),
            "imageSize": np.array([[float(SIZE[1])], [float(SIZE[0])]]),
            "rotation": rotation,
            "translation": 1000 * translation[:, None],
            "rotation_EulerAngles": np.zeros(3),
        }
        (videos / f"Cam{n}").mkdir(parents=True, exist_ok=True)
        file = videos / f"Cam{n}" / "cameraIntrinsicsExtrinsics.pickle"
        file.write_bytes(pickle.dumps({**content, **change}, protocol))
    return videos


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_opencap(tmp_path: Path, protocol: int) -> None:
    videos = opencap(tmp_path / "Videos", protocol)
    if protocol == 2:  # as numpy 1 wrote them, in text that can be replaced
        for file in videos.glob("*/*.pickle"):
            file.write_bytes(file.read_bytes().replace(b"numpy._core", b"numpy.core"))
    found = read(videos, names=("Cam0", "Cam1"))
    assert found.unit == "m"
    for n in range(2):
        rotation, translation = pose(n)
        expected, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(rotation)[0], translation, lens(n), D)
        np.testing.assert_allclose(see(found.cameras[f"Cam{n}"]), expected.reshape(-1, 2), atol=1e-9)


class _Program:
    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return os.system, ("touch ran",)


def test_a_pickle_with_a_program_is_refused_unrun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInputError, match="which is no array"):
        read(opencap(tmp_path / "Videos", rotation=_Program()), names=("Cam0", "Cam1"))
    assert not (tmp_path / "ran").exists()


# Ours


def test_a_sessions_own_file(tmp_path: Path) -> None:
    taken = read(easymocap(tmp_path / "cal"), names=("01", "02"))
    own = msgspec.structs.replace(taken, unit="cm", source="a board")
    path = tmp_path / "calibration.json"
    path.write_bytes(msgspec.json.encode(own))
    found = read(path, names=("01", "02"))
    assert (found.unit, found.source) == ("m", "a board")
    np.testing.assert_allclose(np.array(found.cameras["02"].translation) * 100, own.cameras["02"].translation)
    assert read(tmp_path, names=("01", "02")) == found
    half = fit_calibration(read_views([("", path)], ("01", "02")), dict.fromkeys(("01", "02"), (320, 240)))
    assert half.cameras["01"].fx == pytest.approx(own.cameras["01"].fx / 2)
