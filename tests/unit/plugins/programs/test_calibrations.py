"""Calibrations of other programs mean here what they meant there, or are refused with the reason."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.session.importing.calibrations import fit_calibration, read_views

K = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])
D = np.array([0.1, -0.2, 0.001, 0.002, 0.3])
R = cv2.Rodrigues(np.array([0.1, -0.2, 0.3]))[0]
T = np.array([[-2.0], [0.5], [0.25]])
SIZES = {"left": (640, 480), "right": (640, 480)}


def read(
    *paths: Path | tuple[str, Path], sizes: dict[str, tuple[int, int]] = SIZES, **options: Any
) -> Calibration:
    places: Sequence[tuple[str, Path]] = [path if isinstance(path, tuple) else ("", path) for path in paths]
    return fit_calibration(read_views(places, list(sizes)), sizes, **options)


def check_pair(calibration: Calibration, scale: float = 1.0) -> None:
    left, right = calibration.cameras["left"], calibration.cameras["right"]
    assert (left.fx, left.fy, left.cx, left.cy) == (800, 810, 320, 240)
    assert left.distortion == tuple(D)
    np.testing.assert_allclose(left.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(right.rotation, R, atol=1e-12)
    np.testing.assert_allclose(right.translation, T.ravel() * scale, rtol=1e-12)


@pytest.fixture
def npz_folder(tmp_path: Path) -> Path:
    np.savez(tmp_path / "left_intrinsics.npz", mtx=K, dist=D)
    np.savez(tmp_path / "right_intrinsics.npz", mtx=K, dist=D)
    np.savez(tmp_path / "stereo.npz", R=R, T=T, E=np.eye(3), F=np.eye(3))
    return tmp_path


def test_npz_of_each_camera_and_the_pair(npz_folder: Path) -> None:
    named = [(name, npz_folder / f"{name}_intrinsics.npz") for name in SIZES]
    check_pair(read(*named, npz_folder / "stereo.npz"))
    inches = read(npz_folder, unit="in")
    check_pair(inches, 0.0254)
    assert inches.unit == "m"
    assert "stereo.npz" in inches.source
    squares = read(npz_folder, unit="squares")
    check_pair(squares)
    assert squares.unit == "squares"


def test_three_files_whose_matrix_is_called_intrinsic(npz_folder: Path) -> None:
    for name in SIZES:
        np.savez(npz_folder / f"{name}_intrinsics.npz", intrinsic=K, distortion=D)
    check_pair(read(npz_folder))


def test_a_folder_is_searched_by_whole_words_first(npz_folder: Path) -> None:
    for name in ("cam1", "cam10"):
        np.savez(npz_folder / f"{name}.npz", mtx=K, dist=D)
    for name in ("left", "right"):
        (npz_folder / f"{name}_intrinsics.npz").unlink()
    sizes = {"cam1": (640, 480), "cam10": (640, 480)}
    assert set(read(npz_folder, sizes=sizes).cameras) == set(sizes)
    with pytest.raises(BadInputError, match="begins with 'left'"):
        read(npz_folder)


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_opencv_storage_with_all_in_one(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"stereo{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in {"M1": K, "D1": D, "M2": K, "D2": D, "R": R, "T": T, "R1": np.eye(3) * 7}.items():
        storage.write(key, value)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.release()
    check_pair(read(path))
    with pytest.raises(BadInputError, match="640x480 pixels, its images are 500x480"):
        read(path, sizes={"left": (500, 480), "right": (640, 480)})


@pytest.mark.parametrize(
    ("first", "second"),
    [("M1", "M2"), ("K0", "K1"), ("mtxL", "mtxR"), ("K_left", "K_right"), ("cameraMatrix1", "cameraMatrix2")],
)
def test_a_pair_whose_keys_are_of_either_side(tmp_path: Path, first: str, second: str) -> None:
    dist = (first.replace("mtx", "dist"), second.replace("mtx", "dist")) if "mtx" in first else ("D1", "D2")
    if first in ("K0", "K_left"):
        dist = (first.replace("K", "D"), second.replace("K", "D"))
    other = np.diag([700.0, 700, 1]) + np.array([[0, 0, 320], [0, 0, 240], [0, 0, 0]])
    np.savez(tmp_path / "pair.npz", **{first: K, second: other, dist[0]: D, dist[1]: D, "R": R, "T": T})
    cameras = read(tmp_path / "pair.npz", sizes={"Right": (640, 480), "left": (640, 480)}).cameras
    assert (cameras["left"].fx, cameras["Right"].fx) == (800, 700)
    assert cameras["Right"].distortion == tuple(D)
    np.testing.assert_allclose(cameras["Right"].translation, T.ravel())


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_the_two_files_of_opencvs_sample(tmp_path: Path, mark: str) -> None:
    parts = {"intrinsics": {"M1": K, "D1": D, "M2": K, "D2": D}, "extrinsics": {"R": R, "T": T, "P1": K}}
    for file, values in parts.items():
        storage = cv2.FileStorage(str(tmp_path / f"{file}.yml"), cv2.FILE_STORAGE_WRITE)
        for key, value in values.items():
            storage.write(key, value)
        storage.release()
        (tmp_path / f"{file}.yml").write_text(mark + (tmp_path / f"{file}.yml").read_text(), encoding="utf-8")
    check_pair(read(tmp_path))
    check_pair(read(tmp_path / "extrinsics.yml", tmp_path / "intrinsics.yml"))
    with pytest.raises(BadInputError, match="no 3x3 camera matrix"):
        read(tmp_path / "extrinsics.yml")


def test_a_pose_for_each_camera(tmp_path: Path) -> None:
    rvec = cv2.Rodrigues(R)[0]
    np.savez(tmp_path / "left.npz", K=K, D=D, rvec=np.zeros(3), tvec=np.zeros(3))
    np.savez(tmp_path / "right.npz", K=K, D=D, rvec=rvec, tvec=T)
    check_pair(read(tmp_path))


def test_toml_of_caliscope_and_of_anipose(tmp_path: Path) -> None:
    def table(head: str, rotation: list[Any], translation: list[float]) -> str:
        return (
            f"[{head}]\nsize = [640, 480]\nmatrix = {K.tolist()}\ndistortions = {D.tolist()}\n"
            f"rotation = {rotation}\ntranslation = {translation}\n"
        )

    zero, eye = [0.0, 0.0, 0.0], np.eye(3).tolist()
    path = tmp_path / "camera_array.toml"
    path.write_text(table("cameras.0", eye, zero) + table("cameras.1", R.tolist(), T.ravel().tolist()))
    sizes = {"cam_0": (640, 480), "cam_1": (640, 480)}
    caliscope = read(path, sizes=sizes)
    check_pair(Calibration(cameras=dict(zip(SIZES, caliscope.cameras.values(), strict=True))))
    path.write_text(
        table("cam_0", zero, zero) + 'name = "left"\n'
        + table("cam_1", cv2.Rodrigues(R)[0].ravel().tolist(), T.ravel().tolist()) + 'name = "right"\n'
        + "[metadata]\nadjusted = true\n"
    )  # fmt: skip
    check_pair(read(path))
    path.write_text(path.read_text().replace("translation", "position", 1))
    with pytest.raises(BadInputError, match="camera left has no translation"):
        read(path)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("rotation = [0, 0, 0]\ntranslation = [0, 0, 0]\n", ""), "has a lens, but no pose yet"),
        (("size = [640, 480]", "size = [480, 640]"), r"turned by 90 degrees \(its rotation_count 1\)"),
    ],
)
def test_what_caliscope_says_beside_a_lens_is_read(
    tmp_path: Path, change: tuple[str, str], reason: str
) -> None:
    path = tmp_path / "camera_array.toml"
    good = (
        f"[cameras.0]\nsize = [640, 480]\nmatrix = {K.tolist()}\ndistortions = {D[:4].tolist()}\n"
        "rotation_count = 1\nfisheye = false\nrotation = [0, 0, 0]\ntranslation = [0, 0, 0]\n"
    )
    path.write_text(good)
    assert read(path, sizes={"cam_0": (640, 480)}).cameras["cam_0"].fx == 800
    path.write_text(good.replace(*change))
    with pytest.raises(BadInputError, match=reason) as refused:
        read(path, sizes={"cam_0": (640, 480)})
    assert "--fit" not in str(refused.value)


def test_images_of_another_size(npz_folder: Path) -> None:
    for name in SIZES:
        path = npz_folder / f"{name}_intrinsics.npz"
        np.savez(path, mtx=K, dist=D, image_width=640, image_height=480)
    half = read(npz_folder, sizes={"left": (320, 240), "right": (640, 480)}).cameras["left"]
    assert (half.fx, half.fy) == (400, 405)
    # The centre of a pixel twice as large lies half a small pixel further on.
    assert (half.cx, half.cy) == (159.75, 119.75)
    other = {"left": (600, 480), "right": (640, 480)}
    with pytest.raises(BadInputError, match="--fit crop"):
        read(npz_folder, sizes=other)
    crop = read(npz_folder, sizes=other, fit="crop").cameras["left"]
    assert (crop.width, crop.fx, crop.cx) == (600, 800, 320)
    said: list[str] = []
    scaled = read(npz_folder, sizes=other, fit="scale", talk=said.append).cameras["left"]
    assert (scaled.fx, scaled.fy, scaled.cy) == (750, 810, 240)
    (stretched,) = (text for text in said if "stretched" in text)
    assert "left" in stretched
    assert "0.938 times as wide and 1 times as high" in stretched
    with pytest.raises(BadInputError, match="turned by 90"):
        read(npz_folder, sizes={"left": (480, 640), "right": (640, 480)})


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"mtx": np.eye(2)}, "no 3x3 camera matrix"),
        ({"mtx": -K}, "its last row is not 0, 0, 1"),
        ({"mtx": K * [[-1], [-1], [1]]}, "a focal length of -"),
        ({"mtx": np.where(np.eye(3), K, 5.0)}, "skew"),
        ({"dist": np.array([np.nan] * 5)}, "not finite"),
        ({"mtx": np.array([[500, np.nan, 320], [0, 500, 240], [0, 0, 1]])}, "not finite"),
        ({"dist": np.arange(8.0)}, "8 distortion coefficients"),
        ({"mtx": np.array([[{}]], dtype=object)}, "cannot read"),
        ({"R": R * 2}, "rotation matrix is not orthonormal"),
        ({"R": -R}, "axes are left-handed"),
        ({"R": np.eye(2)}, "not the shapes of a pose"),
        ({"T": np.zeros(2)}, "not the shapes of a pose"),
    ],
)
def test_bad_intrinsics_and_poses_say_why(npz_folder: Path, change: dict[str, Any], reason: str) -> None:
    for file, good in (("left_intrinsics", {"mtx": K, "dist": D}), ("stereo", {"R": R, "T": T})):
        if set(change) <= set(good):
            np.savez(npz_folder / f"{file}.npz", **{**good, **change})
    with pytest.raises(BadInputError, match=reason):
        read(npz_folder)


def test_a_size_without_pixels_is_refused(npz_folder: Path) -> None:
    np.savez(npz_folder / "left_intrinsics.npz", mtx=K, dist=D, image_width=0, image_height=480)
    with pytest.raises(BadInputError, match="0x480 pixels"):
        read(npz_folder)


def test_what_is_missing_is_named(npz_folder: Path) -> None:
    left, right = (npz_folder / f"{name}_intrinsics.npz" for name in SIZES)
    with pytest.raises(BadInputError, match="no R and T"):
        read(("left", left), ("right", right))
    with pytest.raises(BadInputError, match=r"top, which is not in the recording.*left, right"):
        read(("top", left))
    with pytest.raises(BadInputError, match="are unknown"):
        read(left, right)
    with pytest.raises(BadInputError, match="calibrates a pair, but the recording has 3"):
        read(npz_folder / "stereo.npz", sizes={**SIZES, "top": (640, 480)})
    with pytest.raises(BadInputError, match="camera right has no 3x3 camera matrix"):
        read(("left", left), npz_folder / "stereo.npz")
    with pytest.raises(BadInputError, match="no calibration at"):
        read(npz_folder / "nowhere.npz")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.npz", b"PK\x03\x04 broken"),
        ("a.npz", b""),
        ("a.yml", b"%YAML:1.0\n---\nM1: !!opencv-matrix\n  rows: x"),
        ("a.yml", b"just: words"),
        ("a.xml", b"<opencv_storage><M1"),
        ("a.toml", b"[cameras"),
        ("a.toml", b"[cameras.0]\nmatrix = 'x'"),
        ("a.toml", b"[other]\nx = 1"),
        ("a.qca.txt", b"<calibration><cameras><camera serial='left'/></cameras></calibration>"),
        ("a.qca.txt", b"<calibration>"),
        ("a.txt", b"nothing"),
        ("a.txt", b"cam0=[1 0 0; 0 1"),
        ("a.json", json.dumps({}).encode()),
    ],
)
def test_broken_files_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(BadInputError, match="a\\."):
        read(path)


QCA = """<calibration><cameras><camera serial="{name}">
<fov_video left="0" top="0" right="639" bottom="479"/>
<transform x="{x}" y="2000" z="3000"
 r11="1" r12="0" r13="0" r21="0" r22="0" r23="1" r31="0" r32="-1" r33="0"/>
<intrinsic focalLengthU="51200" focalLengthV="51840" centerPointU="20480" centerPointV="15360" skew="0"
 radialDistortion1="0.1" radialDistortion2="-0.2" radialDistortion3="0.3"
 tangentalDistortion1="0.001" tangentalDistortion2="0.002"/></camera></cameras></calibration>"""


def test_qualisys_looks_where_the_camera_looks(tmp_path: Path) -> None:
    path = tmp_path / "room.qca.txt"
    path.write_text(QCA.format(name="left", x=1000))
    camera = read(path, sizes={"left": (640, 480)}).cameras["left"]
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (800, 810, 320, 240)
    assert camera.distortion == tuple(D)
    # It stands at (1, 2, 3) m with its x axis along the room's x and its top up: it looks along +y.
    rotation, translation = np.array(camera.rotation), np.array(camera.translation)
    np.testing.assert_allclose(-rotation.T @ translation, [1, 2, 3])
    np.testing.assert_allclose(rotation @ [1, 5, 3] + translation, [0, 0, 3], atol=1e-12)
    np.testing.assert_allclose(rotation @ [1, 5, 4] + translation, [0, -1, 3], atol=1e-12)
    with pytest.raises(BadInputError, match="calibrates left: nothing for right"):
        read(path)
    with pytest.raises(BadInputError, match="in mm, not in m"):
        read(path, sizes={"left": (640, 480)}, unit="m")
    path.write_text(QCA.format(name="left", x="far"))
    with pytest.raises(BadInputError, match="'far'"):
        read(path, sizes={"left": (640, 480)})


SCENE = """cam0=[3979.911 0 1244.772; 0 3979.911 1019.507; 0 0 1]
cam1=[3979.911 0 1369.115; 0 3979.911 1019.507; 0 0 1]
doffs=124.343
baseline=193.001
width=2964
height=1988
ndisp=280
"""


@pytest.mark.parametrize("names", [("left", "right"), ("im0", "im1")])
def test_middleburys_depth_is_that_of_its_formula(tmp_path: Path, names: tuple[str, str]) -> None:
    """Z = baseline * f / (d + doffs), according to the page of the scenes of 2014."""
    path = tmp_path / "calib.txt"
    path.write_text(SCENE)
    sizes = dict.fromkeys(names, (2964, 1988))
    left, right = read(path, sizes=sizes).cameras.values()
    disparity_px = 60.0
    depth_m = 0.193001 * 3979.911 / (disparity_px + 124.343)
    (x, y), (x_right, y_right) = (
        (of.fx * (0.1 + of.translation[0]) / depth_m + of.cx, of.fy * 0.2 / depth_m + of.cy)
        for of in (left, right)
    )
    assert (x - x_right, y - y_right) == pytest.approx((disparity_px, 0))
    path.write_text(SCENE.replace("baseline=193.001\n", ""))
    with pytest.raises(BadInputError, match="no baseline"):
        read(path, sizes=sizes)


def test_an_xml_of_another_program_is_named_by_its_root(tmp_path: Path) -> None:
    """ContextCapture's BlocksExchange has a <Block> with its cameras."""
    path = tmp_path / "cameras.xml"
    path.write_text('<?xml version="1.0"?>\n<BlocksExchange version="2.1"><Block><calibration/></Block>\n')
    with pytest.raises(
        BadInputError, match=r"not a calibration of a known format \(its root is <BlocksExchange>\)"
    ):
        read(path)
