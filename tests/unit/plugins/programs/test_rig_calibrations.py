"""Calibrations that hold a whole rig mean here what their programs mean by them, by those programs' formulas.

EasyMocap: easymocap/mytools/camera_utils.py, write_camera and read_camera (P = K [R | T]). nerfstudio:
"Nerfstudio dataset format" on docs.nerf.studio and cameras/cameras.py (rays through pixel centres at + 0.5).
OpenCap: opencap-core's utilsChecker.py, calcIntrinsics and calcExtrinsics. COLMAP's are in
test_colmap_calibrations.py.
"""

import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.session.format.common_times import NOT_SYNCHRONIZED
from capture_app.session.importing.calibrations import fit_calibration, read_views
from capture_app.session.importing.importer import recognize_recording
from capture_app.session.reading.reader import Session
from tests.unit.plugins.programs.known_rig import POINTS, SIZE, Array, D, lens, pose, read, see
from tests.unit.session.conftest import jpeg

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


@pytest.mark.parametrize("inner", ["", "images"])
def test_one_image_a_camera_beside_easymocaps_files(inner: str, tmp_path: Path) -> None:
    (easymocap(tmp_path / "rec") / inner).mkdir(exist_ok=True)
    for name in ("01", "02"):
        (tmp_path / "rec" / inner / f"{name}.jpg").write_bytes(jpeg(int(name), *SIZE))
    assert run(["sessions", "import", str(tmp_path / "rec"), "--out", str(tmp_path / "out")]) == ExitCode.OK
    session = Session.open(tmp_path / "out" / "rec")
    assert [(camera.label or camera.name) for camera in session.manifest.cameras] == ["01", "02"]
    assert len(session.manifest.burst.instants_ns) == 1
    assert session.calibration() is not None


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
    path = transforms(tmp_path / "transforms.json", camera_model="EQUIRECTANGULAR")
    with pytest.raises(BadInputError, match="EQUIRECTANGULAR"):
        read(path)
    with pytest.raises(BadInputError, match="has no fl_x"):
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
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = 1.0
    frames = [{"file_path": f"./cam{n}.png", "transform_matrix": poses[n].tolist()} for n in range(2)]
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({**content, "frames": frames}))
    camera = read(path).cameras["cam0"]
    assert (camera.fx, camera.fy) == pytest.approx((500, 500))
    assert (camera.cx, camera.cy) == (319.5, 239.5)
    for degrees_or_none in (65.2, 0):
        path.write_text(json.dumps({**content, "frames": frames, "camera_angle_x": degrees_or_none}))
        with pytest.raises(BadInputError, match="camera_angle_x") as refused:
            read(path)
        assert "radians" in str(refused.value)


def nerf(folder: Path, lens_of_all: dict[str, Any]) -> Path:
    """A ring of five images in one folder, of which the fourth is absent; camera n stands at x = n."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for n in range(5):
        pose = np.eye(4)
        pose[0, 3] = n
        frames.append({"file_path": f"./images/r_{n}", "transform_matrix": pose.tolist()})
        if n != 3:
            cv2.imwrite(str(folder / "images" / f"r_{n}.png"), np.full((48, 64, 3), 40 * n, np.uint8))
    (folder / "transforms.json").write_text(json.dumps({**lens_of_all, "frames": frames}))
    return folder


@pytest.mark.parametrize("lens_of_all", [{"fl_x": 70, "w": 64, "h": 48}, {"camera_angle_x": 0.8575560}])
def test_a_nerf_folder_as_it_is(
    tmp_path: Path, lens_of_all: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """Each image is a camera; what is absent, as in a part of a set, is left out and said."""
    folder = nerf(tmp_path / "ring", lens_of_all)
    assert run(["sessions", "import", str(folder), "--out", str(tmp_path / "out")]) == ExitCode.OK
    printed = capsys.readouterr()
    assert "4 of 5 images are there" in printed.err
    # One instant has no other to be compared with, and no motion by which to be aligned.
    session = tmp_path / "out" / "ring"
    assert printed.err.splitlines()[-1] == f"next: reconstruct multiview {session} --out ring-multiview"
    assert "time --apply" not in printed.out + printed.err
    assert (printed.out + printed.err).count(NOT_SYNCHRONIZED) == 1
    calibration = Session.open(session).calibration()
    assert calibration is not None
    assert calibration.unit == "arbitrary"
    assert {name: -one.translation[0] for name, one in calibration.cameras.items()} == {
        "r_0": 0, "r_1": 1, "r_2": 2, "r_4": 4
    }  # fmt: skip
    assert calibration.cameras["r_1"].fx == pytest.approx(70, abs=0.02)


def test_some_cameras_of_a_nerf_folder(tmp_path: Path) -> None:
    found = read(nerf(tmp_path / "ring", {"fl_x": 700, "w": SIZE[0], "h": SIZE[1]}), names=("r_1", "r_4"))
    assert [-one.translation[0] for one in found.cameras.values()] == [1, 4]


def test_images_of_several_times_are_no_rig_of_one_instant(tmp_path: Path) -> None:
    path = nerf(tmp_path / "ring", {"fl_x": 70, "w": 64, "h": 48}) / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"][1]["time"] = 0.5
    path.write_text(json.dumps(content))
    assert recognize_recording(path.parent) is None


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
    with pytest.raises(BadInputError, match="which is not an array"):
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
