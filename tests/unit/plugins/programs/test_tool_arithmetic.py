"""Each export opened by its tool's own arithmetic, written here from the tool's source: exact to 0.01 px.

The pictures are read from the export and the dots in them found where the tool, with the numbers of the
export, has the points.
"""

import json
from functools import partial
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.reading.reader import Session
from tests.unit.plugins.programs.dotted import (
    CAMERAS,
    HEIGHT,
    WIDTH,
    Array,
    build,
    farthest_off,
    lens,
    opencv_pixel,
    undistorted,
)

EXACT_PX = 0.01


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return build(tmp_path_factory.mktemp("dotted"))


def first_frame(path: Path) -> Array:
    capture = cv2.VideoCapture(str(path))
    done, frame = capture.read()
    capture.release()
    assert done
    return np.asarray(frame)


def matrix_of(name: str) -> Array:
    camera = lens(name)
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])


def test_the_yardstick(session: Session) -> None:
    """The session's own pictures lie where OpenCV has the points, and half a pixel would be seen."""
    for name in CAMERAS:
        camera = lens(name)
        shown = cv2.imread(str(session.folder / "images" / "rig1" / name / "000000.png"))
        assert shown is not None

        def rays(pixels: Array, name: str = name) -> Array:
            return undistorted(pixels, matrix_of(name), np.array(lens(name).distortion))

        def project(point: Array, name: str = name) -> Array:
            return opencv_pixel(lens(name), point)

        assert farthest_off(shown, project, rays) < EXACT_PX / 2
        moved = msgspec.structs.replace(camera, cx=camera.cx + 0.5)
        shifted = farthest_off(shown, partial(opencv_pixel, moved), rays)
        assert shifted == pytest.approx(0.5, abs=0.05)


def nerfstudio_rays(frame: dict[str, float], pixels: Array) -> Array:
    """cameras.py and camera_utils.py: pixels from 0.5, ten of Newton's steps; x/z and y/z as OpenCV's."""
    at = pixels + 0.5
    wanted = np.stack(
        [(at[:, 0] - frame["cx"]) / frame["fl_x"], -(at[:, 1] - frame["cy"]) / frame["fl_y"]], 1
    )
    wanted[:, 1] *= -1  # undistorted with y down, then turned up again
    k1, k2, k3, p1, p2 = (frame[key] for key in ("k1", "k2", "k3", "p1", "p2"))
    x, y = wanted.T.copy()
    for _ in range(10):
        r = x * x + y * y
        d = 1 + r * (k1 + r * (k2 + r * k3))
        d_r = 2 * (k1 + r * (2 * k2 + r * 3 * k3))
        fx = d * x + 2 * p1 * x * y + p2 * (r + 2 * x * x) - wanted[:, 0]
        fy = d * y + 2 * p2 * x * y + p1 * (r + 2 * y * y) - wanted[:, 1]
        fx_x = d + d_r * x * x + 2 * p1 * y + 6 * p2 * x
        fx_y = d_r * x * y + 2 * p1 * x + 2 * p2 * y
        fy_y = d + d_r * y * y + 2 * p2 * x + 6 * p1 * y
        across = fx_y * fx_y - fx_x * fy_y
        x, y = x + (fx * fy_y - fy * fx_y) / across, y + (fy * fx_x - fx * fx_y) / across
    return np.stack([x, y], axis=1)


def test_nerfstudio(session: Session, tmp_path: Path) -> None:
    """Its rays (cameras.py), and splatfacto's pictures without distortion (full_images_datamanager.py)."""
    report = export_session(session, "nerfstudio", tmp_path / "out", instant=1)
    assert not report.notes
    content = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert [frame["instant"] for frame in content["frames"]] == [1, 1]
    assert [frame["time"] for frame in content["frames"]] == [0.0, 0.0]
    for frame in content["frames"]:
        shown = cv2.imread(str(tmp_path / "out" / frame["file_path"]))
        assert shown is not None
        pose = np.array(frame["transform_matrix"])

        def local(point: Array, pose: Array = pose) -> Array:
            x, y, z = pose[:3, :3].T @ (point - pose[:3, 3])
            return np.array([x / -z, -y / -z])

        def rays(pixels: Array, frame: dict[str, float] = frame) -> Array:
            return nerfstudio_rays(frame, pixels)

        def project(point: Array, frame: dict[str, float] = frame) -> Array:
            """The pixel whose ray goes to the point, by search."""
            pixel = np.array([WIDTH / 2, HEIGHT / 2])
            for _ in range(30):
                near = nerfstudio_rays(frame, pixel + np.array([[0, 0], [0.01, 0], [0, 0.01]]))
                slopes = (near[1:] - near[0]).T / 0.01
                pixel = pixel + np.linalg.solve(slopes, local(point) - near[0])
            return pixel

        assert farthest_off(shown, project, rays) < EXACT_PX
        matrix = np.array(
            [[frame["fl_x"], 0, frame["cx"] - 0.5], [0, frame["fl_y"], frame["cy"] - 0.5], [0, 0, 1]]
        )
        given = np.array([frame[key] for key in ("k1", "k2", "p1", "p2", "k3")] + [0.0] * 3)
        straight, (left, top, wide, high) = cv2.getOptimalNewCameraMatrix(matrix, given, (WIDTH, HEIGHT), 0)
        flat = cv2.undistort(shown, matrix, given, None, straight)[top : top + high, left : left + wide]
        straight = np.asarray(straight) + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])

        def splat(point: Array, straight: Array = straight) -> Array:
            return np.asarray((straight @ [*local(point), 1])[:2] - 0.5)

        def flat_rays(pixels: Array, straight: Array = straight) -> Array:
            return np.asarray((pixels + 0.5 - straight[:2, 2]) / [straight[0, 0], straight[1, 1]])

        # It undistorts by OpenCV's tables, which are of 1/32 px, and bilinearly.
        assert farthest_off(np.asarray(flat), splat, flat_rays) < EXACT_PX + 1 / 64


def yaml_cameras(folder: Path) -> dict[str, dict[str, Array]]:
    """EasyMocap's and EasyVolcap's read_camera."""
    intri = cv2.FileStorage(str(folder / "intri.yml"), cv2.FILE_STORAGE_READ)
    extri = cv2.FileStorage(str(folder / "extri.yml"), cv2.FILE_STORAGE_READ)
    names = intri.getNode("names")
    cameras = {}
    for name in [names.at(index).string() for index in range(names.size())]:
        turn = extri.getNode(f"R_{name}").mat()
        cameras[name] = {
            "K": np.asarray(intri.getNode(f"K_{name}").mat()),
            "D": np.asarray(intri.getNode(f"dist_{name}").mat()),
            "R": np.asarray(cv2.Rodrigues(turn)[0]),
            "T": np.asarray(extri.getNode(f"T_{name}").mat()),
        }
        assert np.allclose(cameras[name]["R"], extri.getNode(f"Rot_{name}").mat(), atol=1e-12)
        assert int(intri.getNode(f"H_{name}").real()) == HEIGHT
        assert int(intri.getNode(f"W_{name}").real()) == WIDTH
    return cameras


def test_easymocap(session: Session, tmp_path: Path) -> None:
    """mytools/camera_utils.py: keypoints by Undistort.points, points by P = K [R|T]."""
    export_session(session, "easymocap", tmp_path / "out", lossless=True)
    cameras = yaml_cameras(tmp_path / "out")
    assert sorted(f"{name}.mp4" for name in cameras) == sorted(
        path.name for path in (tmp_path / "out" / "videos").iterdir()
    )
    for name, camera in cameras.items():
        matrix, given = camera["K"], camera["D"]

        def rays(pixels: Array, matrix: Array = matrix, given: Array = given) -> Array:
            return undistorted(pixels, matrix, given)

        def project(point: Array, camera: dict[str, Array] = camera) -> Array:
            """The keypoint that, undistorted, lies on the projected point."""
            turn = cv2.Rodrigues(camera["R"])[0]
            seen = cv2.projectPoints(point.reshape(1, 1, 3), turn, camera["T"], camera["K"], camera["D"])[0]
            pixel = np.asarray(seen).reshape(2)
            flat = camera["K"] @ [*undistorted(pixel[None], camera["K"], camera["D"])[0], 1]
            by_matrix = camera["K"] @ (camera["R"] @ point[:, None] + camera["T"])
            assert flat[:2] == pytest.approx(by_matrix[:2, 0] / by_matrix[2, 0], abs=1e-6)
            return pixel

        assert (
            farthest_off(first_frame(tmp_path / "out" / "videos" / f"{name}.mp4"), project, rays) < EXACT_PX
        )


def test_easyvolcap(session: Session, tmp_path: Path) -> None:
    """utils/data_utils.py undistorts with an optimal matrix, utils/ray_utils.py adds half a pixel."""
    export_session(session, "easyvolcap", tmp_path / "out", lossless=True)
    cameras = yaml_cameras(tmp_path / "out")
    folders = sorted(path.name for path in (tmp_path / "out" / "images").iterdir())
    assert folders == sorted(cameras)
    for name, camera in cameras.items():
        shown = cv2.imread(str(tmp_path / "out" / "images" / name / "000000.png"))
        assert shown is not None
        best = cv2.getOptimalNewCameraMatrix(camera["K"], camera["D"], (WIDTH, HEIGHT), 0, (WIDTH, HEIGHT))[0]
        flat = cv2.undistort(shown, camera["K"], camera["D"], newCameraMatrix=best)
        assert np.array_equal(flat, shown)
        matrix = np.asarray(best)

        def project(point: Array, camera: dict[str, Array] = camera, matrix: Array = matrix) -> Array:
            seen = matrix @ (camera["R"] @ point[:, None] + camera["T"])
            return np.asarray(seen[:2, 0] / seen[2, 0] - 0.5)

        def rays(pixels: Array, matrix: Array = matrix) -> Array:
            return np.asarray(
                (np.linalg.inv(matrix) @ np.column_stack([pixels + 0.5, np.ones(len(pixels))]).T).T[:, :2]
            )

        assert farthest_off(np.asarray(flat), project, rays) < EXACT_PX
