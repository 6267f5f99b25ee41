"""COLMAP's calibrations mean here what COLMAP means by them: its own library writes the models.

And docs colmap.github.io/format.html, rigs.html.
"""

import json
from pathlib import Path
from typing import Any

import cv2  # before pycolmap
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from tests.unit.plugins.programs.known_rig import POINTS, SIZE, D, lens, pose, read, see

pycolmap: Any = None


@pytest.fixture(autouse=True)
def _pycolmap() -> None:
    """Half a second, only where it is used: each of pytest's workers imports all tests."""
    globals()["pycolmap"] = pytest.importorskip("pycolmap")


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
