"""Fields that change the meaning of a recording: for each importer a table, and each field set alone.

A field is read, so that the lens or picture changes as it must, or it is refused by name.
"""

import json
import pickle
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.plugins.footage.sound import read_sound
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.importing.calibrations import fit_calibration, read_views
from capture_app.session.importing.recording_sources import Video
from tests.imported import import_one
from tests.unit.plugins.programs.test_mcap_reader import Recorder
from tests.unit.session.conftest import jpeg

K = [[800.0, 0.0, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]]
EYE = np.eye(3).tolist()
MIRROR = np.diag([1.0, 1.0, -1.0]).tolist()
SIZE = (640, 480)
Write = Callable[[Path, dict[str, Any]], Path]


def caliscope(folder: Path, fields: dict[str, Any]) -> Path:
    table = {"size": [*SIZE], "matrix": K, "distortions": [0.0] * 4, "rotation": [0.0] * 3}
    table |= {"translation": [0.0] * 3, "fisheye": False, "rotation_count": 0} | fields
    path = folder / "camera_array.toml"
    path.write_text("[cameras.0]\n" + "".join(f"{key} = {json.dumps(of)}\n" for key, of in table.items()))
    return path


def pose2sim(folder: Path, fields: dict[str, Any]) -> Path:
    table: dict[str, Any] = {"name": "0", "size": [640.0, 480.0], "matrix": K, "distortions": [0.0] * 4}
    table |= {"rotation": [0.0] * 3, "translation": [0.0] * 3, "fisheye": False} | fields
    path = folder / "Calib.toml"
    lines = "".join(f"{key} = {json.dumps(of)}\n" for key, of in table.items())
    path.write_text(f"[cam_01]\n{lines}\n[metadata]\nadjusted = false\nerror = 0.0\n")
    return path


def freemocap(folder: Path, fields: dict[str, Any]) -> Path:
    """The calibration of a recording; its square is in mm, which the recording's importer says."""
    table = {"name": "0", "size": [*SIZE], "matrix": K, "distortions": [0.0] * 5, "rotation": [0.0] * 3}
    table |= {"translation": [0.0] * 3, "world_position": [0.0] * 3} | fields
    path = folder / "take_camera_calibration.toml"
    lines = "".join(f"{key} = {json.dumps(of)}\n" for key, of in table.items())
    path.write_text(f"[cam_0]\n{lines}\n[metadata]\ncharuco_square_size = 39.0\n")
    return path


def opencap(folder: Path, fields: dict[str, Any]) -> Path:
    content = {"intrinsicMat": np.array(K), "distortion": np.zeros((1, 5)), "imageSize": np.array([480, 640])}
    content |= {"rotation": np.eye(3), "translation": np.zeros((3, 1))} | fields
    path = folder / "Cam0" / "cameraIntrinsicsExtrinsics.pickle"
    path.parent.mkdir()
    path.write_bytes(pickle.dumps(content))
    return path


def middlebury(folder: Path, fields: dict[str, Any]) -> Path:
    content = {"cam0": "[800 0 320; 0 810 240; 0 0 1]", "cam1": "[800 0 330; 0 810 240; 0 0 1]"}
    content |= {"doffs": "10", "baseline": "100", "width": "640", "height": "480", "ndisp": "64"} | fields
    path = folder / "calib.txt"
    path.write_text("".join(f"{key}={of}\n" for key, of in content.items()))
    return path


def opencv(folder: Path, fields: dict[str, Any]) -> Path:
    path = folder / "camera.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (
        {"K": np.array(K), "D": np.zeros(5), "R": np.eye(3), "T": np.zeros(3)} | fields
    ).items():
        storage.write(key, value)
    storage.release()
    return path


def qualisys(folder: Path, fields: dict[str, Any]) -> Path:
    one = {"viewrotation": 0, "skew": 0, "left": 0, "r33": -1, "focalLengthU": 51200} | fields
    path = folder / "room.qca.txt"
    path.write_text(
        f'<calibration><cameras><camera serial="0" viewrotation="{one["viewrotation"]}">'
        f'<fov_video left="{one["left"]}" top="0" right="{one["left"] + 639}" bottom="479"/>'
        '<transform x="0" y="0" z="0" r11="1" r12="0" r13="0" r21="0" '
        f'r22="-1" r23="0" r31="0" r32="0" r33="{one["r33"]}"/>'
        f'<intrinsic focalLengthU="{one["focalLengthU"]}" focalLengthV="51840" centerPointU="20480" '
        f'centerPointV="15360" skew="{one["skew"]}" radialDistortion1="0" radialDistortion2="0" '
        'radialDistortion3="0" tangentalDistortion1="0" tangentalDistortion2="0"/>'
        "</camera></cameras></calibration>"
    )
    return path


def nerfstudio(folder: Path, fields: dict[str, Any]) -> Path:
    lens = {"fl_x": 800.0, "fl_y": 810.0, "cx": 320.5, "cy": 240.5, "w": 640, "h": 480, "k1": 0.0}
    pose = np.diag([1.0, -1.0, -1.0, 1.0]).tolist()
    frames = [{"file_path": "images/0/000.jpg", "transform_matrix": pose}]
    path = folder / "transforms.json"
    path.write_text(json.dumps(lens | {"camera_model": "OPENCV", "frames": frames} | fields))
    return path


def colmap(folder: Path, fields: dict[str, Any]) -> Path:
    model, numbers = fields.get("model", ("PINHOLE", "800 810 320.5 240.5"))
    (folder / "cameras.txt").write_text(f"1 {model} 640 480 {numbers}\n")
    (folder / "images.txt").write_text("1 1 0 0 0 0 0 0 1 0/000.jpg\n\n")
    return folder


def easymocap(folder: Path, fields: dict[str, Any]) -> Path:
    content = {"K_0": np.array(K), "dist_0": np.zeros((1, 5))} | fields
    for file, values in (("intri", content), ("extri", {"R_0": np.zeros(3), "T_0": np.zeros(3)})):
        storage = cv2.FileStorage(str(folder / f"{file}.yml"), cv2.FILE_STORAGE_WRITE)
        storage.startWriteStruct("names", cv2.FileNode_SEQ)
        storage.write("", "0")
        storage.endWriteStruct()
        for key, value in values.items():
            storage.write(key, value)
        storage.release()
    return folder


READ: list[tuple[Write, dict[str, Any], dict[str, float]]] = [
    (caliscope, {"rotation": EYE}, {}),
    (caliscope, {"size": [1280, 960]}, {"fx": 400, "fy": 405, "cx": 159.75, "cy": 119.75}),
    (caliscope, {"distortions": [0.1, 0.0, 0.0, 0.0, 0.2]}, {"k1": 0.1, "k3": 0.2}),
    (caliscope, {"fisheye": False}, {}),
    (caliscope, {"rotation_count": 2}, {}),
    (pose2sim, {"rotation": EYE}, {}),
    (pose2sim, {"size": [1280.0, 960.0]}, {"fx": 400, "fy": 405, "cx": 159.75, "cy": 119.75}),
    (pose2sim, {"distortions": [0.1, 0.0, 0.02, 0.0]}, {"k1": 0.1, "p1": 0.02}),
    (freemocap, {"size": [1280, 960]}, {"fx": 400, "fy": 405, "cx": 159.75, "cy": 119.75}),
    (freemocap, {"distortions": [0.1, 0.0, 0.0, 0.0, 0.2]}, {"k1": 0.1, "k3": 0.2}),
    (freemocap, {"translation": [1.0, 2.0, 3.0]}, {"x": 1, "y": 2, "z": 3}),
    (opencap, {"imageSize": np.array([960, 1280])}, {"fx": 400, "fy": 405, "cx": 159.75, "cy": 119.75}),
    (opencap, {"distortion": np.array([[0.1, 0, 0, 0, 0.2]])}, {"k1": 0.1, "k3": 0.2}),
    (opencap, {"translation": np.array([[1000.0], [0], [500]])}, {"x": 1, "z": 0.5}),
    (middlebury, {"width": "1280", "height": "960"}, {"fx": 400, "fy": 405, "cx": 159.75, "cy": 119.75}),
    (middlebury, {"cam0": "[900 0 320; 0 810 240; 0 0 1]"}, {"fx": 900}),
    (opencv, {"image_width": 1280, "image_height": 960}, {"fx": 400, "fy": 405, "cx": 159.75, "cy": 119.75}),
    (opencv, {"fisheye_model": 0}, {}),
    (opencv, {"D": np.array([0.1, 0, 0, 0, 0.2])}, {"k1": 0.1, "k3": 0.2}),
    (qualisys, {"left": 20}, {"cx": 300}),
    (qualisys, {"focalLengthU": 64000}, {"fx": 1000}),
    (nerfstudio, {"fl_y": 900.0}, {"fy": 900}),
    (nerfstudio, {"k1": 0.1}, {"k1": 0.1}),
    (nerfstudio, {"w": 1280, "h": 960}, {"fx": 400, "fy": 405, "cx": 159.75, "cy": 119.75}),
    (colmap, {"model": ("SIMPLE_RADIAL", "800 320.5 240.5 0.1")}, {"fy": 800, "k1": 0.1}),
    (easymocap, {"dist_0": np.array([[0.1, 0, 0, 0, 0.2]])}, {"k1": 0.1, "k3": 0.2}),
    (easymocap, {"H_0": 960, "W_0": 1280}, {"fx": 400, "fy": 405, "cx": 159.75, "cy": 119.75}),
]
REFUSED: list[tuple[Write, dict[str, Any], str]] = [
    (caliscope, {"size": [480, 640], "rotation_count": 1}, "rotation_count 1"),
    (caliscope, {"distortions": [0.1] * 8}, "8 distortion coefficients"),
    (caliscope, {"matrix": [[800.0, 3.0, 320.0], *K[1:]]}, "skew"),
    (caliscope, {"rotation": MIRROR}, "axes are left-handed"),
    (pose2sim, {"rotation": MIRROR}, "axes are left-handed"),
    (pose2sim, {"matrix": [[800.0, 3.0, 320.0], *K[1:]]}, "skew"),
    (freemocap, {"distortions": [0.1] * 8}, "8 distortion coefficients"),
    (opencap, {"distortion": np.full((1, 8), 0.1)}, "distortion has 8 numbers"),
    (opencap, {"imageSize": np.array([640, 480])}, "calibrated for 480x640 pixels"),
    (opencap, {"rotation": np.array(MIRROR)}, "axes are left-handed"),
    (middlebury, {"cam0": "[800 3 320; 0 810 240; 0 0 1]"}, "skew"),
    (middlebury, {"doffs": "0"}, "doffs is 0"),
    (opencv, {"R": np.array(MIRROR)}, "axes are left-handed"),
    (opencv, {"D": np.arange(8.0)}, "8 distortion coefficients"),
    (qualisys, {"viewrotation": 90}, "view rotated by 90"),
    (qualisys, {"skew": 640}, "skew"),
    (qualisys, {"r33": 1}, "axes are left-handed"),
    (nerfstudio, {"camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR"),
    (nerfstudio, {"is_fisheye": True}, "only perspective"),
    (nerfstudio, {"k4": 0.1}, "k4"),
    (
        nerfstudio,
        {"frames": [{"file_path": "0/0.jpg", "transform_matrix": np.eye(4)[[1, 0, 2, 3]].tolist()}]},
        "axes are left-handed",
    ),
    (colmap, {"model": ("FULL_OPENCV", "800 810 320.5 240.5 0 0 0 0 0 0.1 0 0")}, "8 distortion"),
    (easymocap, {"dist_0": np.full((1, 8), 0.1)}, "8 distortion coefficients"),
]


_BENT = [0.1, 0.02, 0.003, 0.0004]
FISHEYES: list[tuple[Write, dict[str, Any]]] = [
    (caliscope, {"fisheye": True, "distortions": _BENT}),
    (pose2sim, {"fisheye": True, "distortions": _BENT}),
    (freemocap, {"fisheye": True, "distortions": _BENT}),
    (opencv, {"fisheye_model": 1, "D": np.array(_BENT)}),
    (opencv, {"distortion_model": "equidistant", "D": np.array(_BENT)}),
    (
        nerfstudio,
        {"camera_model": "OPENCV_FISHEYE"} | dict(zip(("k1", "k2", "k3", "k4"), _BENT, strict=True)),
    ),
    (colmap, {"model": ("OPENCV_FISHEYE", f"800 810 320.5 240.5 {' '.join(map(str, _BENT))}")}),
]


def named(case: tuple[Any, ...]) -> str:
    return f"{case[0].__name__}-{'-'.join(map(str, case[1]))}-{next(iter(case[1].values()))}"[:60]


def read(path: Path) -> CameraCalibration:
    name = "0" if path.suffix == ".yml" else ""
    return fit_calibration(read_views([(name, path)], ["0"]), {"0": SIZE}).cameras["0"]


def values_of(camera: CameraCalibration) -> dict[str, float]:
    names = ("fx", "fy", "cx", "cy")
    return {name: getattr(camera, name) for name in names} | dict(
        zip(
            ("k1", "k2", "p1", "p2", "k3", "x", "y", "z"), camera.distortion + camera.translation, strict=True
        )
    )


@pytest.mark.parametrize("case", READ, ids=named)
def test_a_field_that_is_read_changes_what_it_means(
    case: tuple[Write, dict[str, Any], dict[str, float]], tmp_path: Path
) -> None:
    write, fields, changes = case
    (tmp_path / "plain").mkdir()
    plain = values_of(read(write(tmp_path / "plain", {})))
    assert plain == pytest.approx(
        {"fx": 800, "fy": 810, "cx": 320, "cy": 240} | dict.fromkeys([*plain][4:], 0)
    )
    assert values_of(read(write(tmp_path, fields))) == pytest.approx(plain | changes)


@pytest.mark.parametrize("case", REFUSED, ids=named)
def test_a_field_that_is_not_read_is_refused_by_name(
    case: tuple[Write, dict[str, Any], str], tmp_path: Path
) -> None:
    write, fields, word = case
    with pytest.raises(BadInputError, match=word):
        read(write(tmp_path, fields))


@pytest.mark.parametrize(
    ("fields", "topic", "calibrated"),
    [
        ({}, "image", True),
        ({"distortion_model": "rational_polynomial"}, "image", True),
        ({"distortion_model": "equidistant", "D": [0.1] * 4}, "image", True),
        ({"distortion_model": "kannala_brandt", "D": [0.1] * 4}, "image", False),
        ({}, "image_rect", False),
    ],
)
def test_a_lens_in_a_bag(fields: dict[str, Any], topic: str, calibrated: bool, tmp_path: Path) -> None:
    """What is not read of the lens is said, and the pictures are imported without it."""
    recorder = Recorder(tmp_path / "drive.mcap")
    lens = {"width": 16, "height": 12, "distortion_model": "plumb_bob", "D": [0.1, 0, 0, 0, 0]} | fields
    lens["K"] = [20.0, 0, 7.5, 0, 21.0, 5.5, 0, 0, 1]
    for n, name in enumerate(("front", "right")):
        place, turn = {"x": float(n), "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        frames = {"parent_frame_id": "base", "child_frame_id": name}
        recorder.add("/tf", "FrameTransform", 10**9, **frames, translation=place, rotation=turn)
        recorder.add(f"/{name}/info", "CameraCalibration", 10**9, frame_id=name, **lens)
        recorder.add(f"/{name}/{topic}", "CompressedImage", 10**9, frame_id=name, data=jpeg(n), format="jpeg")
    recorder.close()
    said: list[str] = []
    session = import_one([str(tmp_path / "drive.mcap")], tmp_path, "s", ImportOptions(), talk=said.append)
    assert (session.calibration() is not None) == calibrated
    assert any("calibration in it is not taken" in line for line in said) != calibrated
    assert len(session.manifest.images) == 2


def video(path: Path, *, luma: int = 100, red: int = 128, **fields: Any) -> Path:
    """A video of one frame whose stream has a field set."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        frame = av.VideoFrame(64, 48, "yuv420p")
        for plane, value in zip(frame.planes, (luma, 128, red), strict=True):
            plane.update(bytes([value]) * plane.buffer_size)
        for name, value in fields.items():
            setattr(stream.codec_context, name, value)
            if name != "sample_aspect_ratio":
                setattr(frame, name, value)
        frame.pts, frame.time_base = 0, Fraction(1, 25)
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(
    ("picture", "fields", "size", "bgr"),
    [
        ({}, {}, (64, 48), (98, 98, 98)),
        ({}, {"color_range": 1}, (64, 48), (98, 98, 98)),
        ({}, {"color_range": 2}, (64, 48), (100, 100, 100)),
        ({"red": 240}, {"colorspace": 5}, (64, 48), (98, 7, 255)),
        ({"red": 240}, {"colorspace": 1}, (64, 48), (98, 38, 255)),
        ({}, {"sample_aspect_ratio": Fraction(4, 3)}, (85, 48), (98, 98, 98)),
        ({}, {"sample_aspect_ratio": Fraction(1, 1)}, (64, 48), (98, 98, 98)),
    ],
)
def test_a_field_of_a_video(
    picture: dict[str, int],
    fields: dict[str, Any],
    size: tuple[int, int],
    bgr: tuple[int, ...],
    tmp_path: Path,
) -> None:
    """Range and matrix of its colours, and the shape of its pixels: as a player shows it."""
    ((_, data, found),) = Video("a", video(tmp_path / "a.mp4", **picture, **fields), png=True).frames([0])
    assert found == size
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image[20, 20].tolist() == pytest.approx(bgr, abs=3)


def test_lengths_of_freemocap_are_mm(tmp_path: Path) -> None:
    """Its calibration does not say so; that of another program in the same format is in metres."""
    folder = tmp_path / "take"
    (folder / "synchronized_videos").mkdir(parents=True)
    video(folder / "synchronized_videos" / "take.id-0.idx-0.mp4")
    path = freemocap(folder, {"translation": [1500.0, 0.0, -250.0]})
    assert read(path).translation == (1500.0, 0.0, -250.0)
    calibration = import_one([str(folder)], tmp_path, "s", ImportOptions()).calibration()
    assert calibration is not None
    assert calibration.unit == "m"
    assert calibration.cameras["0"].translation == pytest.approx((1.5, 0.0, -0.25))


@pytest.mark.parametrize(
    ("layout", "loud"), [("mono", [True]), ("stereo", [True, False]), ("stereo", [False, True])]
)
def test_each_channel_of_a_sound_is_read(layout: str, loud: list[bool], tmp_path: Path) -> None:
    """One may have a timecode and the other the room: they are not summed."""
    with av.open(str(tmp_path / "a.mov"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=48_000, layout=layout)
        wave = (8000 * np.sin(np.arange(48_000) / 20)).astype(np.int16)
        samples = np.stack([wave * one for one in loud], axis=1).reshape(1, -1)
        frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(samples), format="s16", layout=layout)
        frame.sample_rate = 48_000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    channels, _ = read_sound(tmp_path / "a.mov")
    assert len(channels) == 2 or layout == "mono"
    assert [bool(np.abs(one).max() > 0.1) for one in channels][: len(loud)] == loud


@pytest.mark.parametrize("case", FISHEYES, ids=named)
def test_fisheyes_are_read(case: tuple[Write, dict[str, Any]], tmp_path: Path) -> None:
    write, fields = case
    camera = read(write(tmp_path, fields))
    assert camera.is_fisheye
    assert camera.distortion == tuple(_BENT)
    assert (camera.fx, camera.cx) == (800, 320)
