"""Calibrations of public data sets and of small programs mean here what their own code makes of them.

KITTI: Geiger et al. 2013 and devkit/readme.txt (y = P_rect_i R_rect_00 x), with the numbers of 2011_09_28.
EuRoC: projects.asl.ethz.ch/datasets, with those of MH_01. CMU Panoptic: python/panutils.py, projectPoints.
handpose3d: utils.py, get_projection_matrix. DeepLabCut: pose_estimation_3d/camera_calibration.py. LLFF: its
README and NeRF's load_llff.py and run_nerf_helpers.py.
"""

import json
import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.lens import lens_of, rotation_of, translation_of
from capture_app.session.importing.calibrations import fit_calibration, read_views
from capture_app.session.importing.importer import recognize_recording
from capture_app.session.importing.views import View
from tests.unit.plugins.programs.known_rig import POINTS, Array, D, lens, pose
from tests.unit.session.conftest import jpeg

POINTS_FAR = POINTS * [4.0, 2.0, 4.0]


def read(path: Path, names: tuple[str, ...], size: tuple[int, int], **options: Any) -> Calibration:
    return fit_calibration(read_views([("", path)], names), dict.fromkeys(names, size), **options)


def pixels(found: Calibration, name: str, points: Array) -> Array:
    """Return where the product's lens has points of the rig, (n, 2)."""
    camera = found.cameras[name]
    seen = points @ rotation_of(camera).T + translation_of(camera)
    return lens_of(camera).project(seen[:, :2] / seen[:, 2:])


def homogeneous(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))]).T


# KITTI

CAM_TO_CAM = """calib_time: 09-Jan-2012 13:58:50
corner_dist: 9.950000e-02
S_02: 1.392000e+03 5.120000e+02
K_02: 9.569475e+02 0.000000e+00 6.939767e+02 0.000000e+00 9.522352e+02 2.386081e+02 0.000000e+00 0.000000e+00 1.000000e+00
D_02: -3.750956e-01 2.076838e-01 4.348525e-04 1.603162e-03 -7.469243e-02
R_02: 9.999838e-01 -5.012736e-03 -2.710741e-03 5.002007e-03 9.999797e-01 -3.950381e-03 2.730489e-03 3.936758e-03 9.999885e-01
T_02: 5.989688e-02 -1.367835e-03 4.637624e-03
S_rect_02: 1.224000e+03 3.700000e+02
R_rect_00: 9.999128e-01 1.009263e-02 -8.511932e-03 -1.012729e-02 9.999406e-01 -4.037671e-03 8.470675e-03 4.123522e-03 9.999556e-01
P_rect_02: 7.070493e+02 0.000000e+00 6.040814e+02 4.575831e+01 0.000000e+00 7.070493e+02 1.805066e+02 -3.454157e-01 0.000000e+00 0.000000e+00 1.000000e+00 4.981016e-03
K_03: 9.011007e+02 0.000000e+00 6.982947e+02 0.000000e+00 8.970639e+02 2.377447e+02 0.000000e+00 0.000000e+00 1.000000e+00
D_03: -3.686011e-01 1.908666e-01 -5.689518e-04 3.332341e-04 -6.302873e-02
R_03: 9.995054e-01 1.665288e-02 -2.667675e-02 -1.671777e-02 9.998578e-01 -2.211228e-03 2.663614e-02 2.656110e-03 9.996417e-01
T_03: -4.756270e-01 5.296617e-03 -5.437198e-03
S_03: 1.392000e+03 5.120000e+02
S_rect_03: 1.224000e+03 3.700000e+02
P_rect_03: 7.070493e+02 0.000000e+00 6.040814e+02 -3.341081e+02 0.000000e+00 7.070493e+02 1.805066e+02 2.330660e+00 0.000000e+00 0.000000e+00 1.000000e+00 3.201153e-03
"""  # noqa: E501
KITTI = dict(line.split(": ", 1) for line in CAM_TO_CAM.splitlines())
DRIVE = "image_02", "image_03"


def of_kitti(key: str, *shape: int) -> Array:
    return np.array(KITTI[key].split(), np.float64).reshape(shape)


def orthonormal(rotation: Array) -> Array:
    """The nearest rotation: the files have seven digits."""
    left, _, right = np.linalg.svd(rotation)
    return np.asarray(left @ right)


def test_kittis_rectified_drive(tmp_path: Path) -> None:
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text(CAM_TO_CAM)
    found = read(path, DRIVE, (1224, 370))
    assert found.unit == "m"
    turned = np.eye(4)
    turned[:3, :3] = orthonormal(of_kitti("R_rect_00", 3, 3))
    for name in DRIVE:
        seen = of_kitti(f"P_rect_{name[-2:]}", 3, 4) @ turned @ homogeneous(POINTS_FAR)
        np.testing.assert_allclose(pixels(found, name, POINTS_FAR), (seen[:2] / seen[2]).T, atol=1e-6)


def test_kittis_drive_before_rectification(tmp_path: Path) -> None:
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text(CAM_TO_CAM)
    found = read(path, DRIVE, (1392, 512))
    for name in DRIVE:
        n = name[-2:]
        rotation = orthonormal(of_kitti(f"R_{n}", 3, 3))
        translation, matrix = of_kitti(f"T_{n}", 3), of_kitti(f"K_{n}", 3, 3)
        seen, _ = cv2.projectPoints(
            POINTS_FAR, cv2.Rodrigues(rotation)[0], translation, matrix, of_kitti(f"D_{n}", 5)
        )
        np.testing.assert_allclose(pixels(found, name, POINTS_FAR), seen.reshape(-1, 2), atol=1e-6)


def test_kittis_odometry(tmp_path: Path) -> None:
    """Images of any size: the file states none. A rectified pair of one drive, as sequence 00 has it."""
    path = tmp_path / "calib.txt"
    rows = {n: np.array([[718.856, 0, 607.1928, tx], [0, 718.856, 185.2157, 0], [0, 0, 1, 0]]) for n, tx in
            ((0, 0.0), (1, -386.1448), (2, 45.38225), (3, -337.2877))}  # fmt: skip
    lines = (f"P{n}: {' '.join(f'{x:.12e}' for x in row.ravel())}\n" for n, row in rows.items())
    path.write_text("".join(lines) + "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    found = read(path, ("image_0", "image_1"), (1241, 376))
    assert found.unit == "m"
    for n in (0, 1):
        seen = rows[n] @ homogeneous(POINTS_FAR)
        np.testing.assert_allclose(pixels(found, f"image_{n}", POINTS_FAR), (seen[:2] / seen[2]).T, atol=1e-6)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("P_rect_03", "1 2 3", "P_rect_03 has 3 numbers, not 12"),
        ("R_rect_00", "a b c", "R_rect_00 is not made of numbers"),
        ("S_rect_02", "", "has no S_rect_02"),
        ("P_rect_02", " ".join(["0"] * 12), "camera image_02"),
    ],
)
def test_kittis_numbers_that_are_wrong_are_named(key: str, value: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text("".join(f"{name}: {text}\n" for name, text in (KITTI | {key: value}).items()))
    with pytest.raises(BadInputError, match=said):
        read(path, DRIVE, (1224, 370))


# EuRoC

T_BS = (
    "0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,\n"
    "         0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,\n"
    "        -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949,\n"
    "         0.0, 0.0, 0.0, 1.0",
    "0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556,\n"
    "         0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024,\n"
    "        -0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038,\n"
    "         0.0, 0.0, 0.0, 1.0",
)
SENSOR = """#Default values for the camera
sensor_type: camera
comment: VI-Sensor cam{n} (MT9M034)

# Sensor extrinsics wrt. the body-frame.
T_BS:
  cols: 4
  rows: 4
  data: [{pose}]

# Camera specific definitions.
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: {model}
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
"""


def euroc(folder: Path, model: str = "radial-tangential", inner: str = "mav0") -> Path:
    for n, pose_of in enumerate(T_BS):
        (folder / inner / f"cam{n}").mkdir(parents=True)
        text = SENSOR.format(n=n, pose=pose_of, model=model)
        (folder / inner / f"cam{n}" / "sensor.yaml").write_text(text)
    return folder


@pytest.mark.parametrize("inner", ["", "mav0"])
@pytest.mark.parametrize("model", ["radial-tangential", "equidistant"])
def test_eurocs_sensors(model: str, inner: str, tmp_path: Path) -> None:
    """A point of the sensor is x_B = T_BS x_S in the body's frame, which is the rig's."""
    found = read(euroc(tmp_path, model, inner), ("cam0", "cam1"), (752, 480))
    assert found.unit == "m"
    x, y = (POINTS[:, :2] / POINTS[:, 2:]).T
    k1, k2, p1, p2 = -0.28340811, 0.07395907, 0.00019359, 1.76187114e-05
    r = np.hypot(x, y)
    if model == "equidistant":
        angle = np.arctan(r)
        bend = (angle + k1 * angle**3 + k2 * angle**5 + p1 * angle**7 + p2 * angle**9) / r
        u, v = bend * x, bend * y
    else:
        bend = 1 + k1 * r**2 + k2 * r**4
        u = bend * x + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
        v = bend * y + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
    expected = np.column_stack([458.654 * u + 367.215, 457.296 * v + 248.375])
    for n, text in enumerate(T_BS):
        body = np.array(text.replace(",", " ").split(), np.float64).reshape(4, 4)
        np.testing.assert_allclose(
            pixels(found, f"cam{n}", (body @ homogeneous(POINTS))[:3].T), expected, atol=1e-6
        )


def test_eurocs_sensors_that_are_not_read(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="is of Kalibr's model pinhole-fov"):
        read(euroc(tmp_path / "fov", "fov"), ("cam0", "cam1"), (752, 480))
    file = euroc(tmp_path / "imu") / "mav0/cam0/sensor.yaml"
    file.write_text("sensor_type: imu\n")
    with pytest.raises(BadInputError, match=r"sensor\.yaml has no R and T"):
        read(file, ("cam0",), (752, 480))


# CMU Panoptic


def panoptic(path: Path, **change: Any) -> Path:
    cameras = []
    for n in range(3):
        rotation, translation = pose(n)
        camera = {"name": f"00_{n:02}", "type": "hd", "resolution": [640, 480], "panel": 0, "node": n}
        camera |= {"K": lens(n).tolist(), "distCoef": [-0.12, 0.03, 0.002, -0.001, 0.01]}
        camera |= {"R": rotation.tolist(), "t": (100 * translation[:, None]).tolist()}
        cameras.append(camera | change)
    path.write_text(json.dumps({"calibDataSource": "160422_calib_norm", "cameras": cameras}))
    return path


@pytest.mark.parametrize("form", ["00_{:02}", "hd_00_{:02}"])
def test_panoptics_cameras(form: str, tmp_path: Path) -> None:
    """Of the studio's cameras, those of the recording: folders of images, or films with the type before."""
    names = tuple(form.format(n) for n in (0, 2))
    said: list[str] = []
    path = panoptic(tmp_path / "calibration_171204_pose1.json")
    found = read(path, names, (640, 480), talk=said.append)
    assert (found.unit, said) == ("m", [])
    for n, name in zip((0, 2), names, strict=True):
        rotation, translation = pose(n)
        x, y, z = rotation @ POINTS.T + translation[:, None]
        x, y = x / z, y / z
        k, r = (-0.12, 0.03, 0.002, -0.001, 0.01), x * x + y * y
        bend = 1 + k[0] * r + k[1] * r * r + k[4] * r * r * r
        u = x * bend + 2 * k[2] * x * y + k[3] * (r + 2 * x * x)
        v = y * bend + 2 * k[3] * x * y + k[2] * (r + 2 * y * y)
        seen = lens(n) @ [u, v, np.ones(3)]
        np.testing.assert_allclose(pixels(found, name, POINTS), seen[:2].T, atol=1e-6)


def test_panoptics_numbers_that_are_wrong_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="camera 00_00: distCoef has 2 numbers, not 5"):
        read(panoptic(tmp_path / "calibration_a.json", distCoef=[0, 1]), ("00_00",), (640, 480))
    (tmp_path / "calibration_b.json").write_text('{"calibDataSource": "", "cameras": [3]}')
    with pytest.raises(BadInputError, match="not a calibration of a known format"):
        read(tmp_path / "calibration_b.json", ("00_00",), (640, 480))


# handpose3d


def handpose(folder: Path, form: tuple[str, str] = ("c{}", "rot_trans_c{}")) -> Path:
    """The files as the author's write_keypoints and save_extrinsic_calibration_parameters print them."""
    folder.mkdir(parents=True)

    def rows(matrix: Array) -> str:
        return "".join(" ".join(str(float(x)) for x in row) + " \n" for row in np.atleast_2d(matrix))

    for n in range(2):
        rotation, translation = pose(n)
        inner = f"intrinsic:\n{rows(lens(n))}distortion:\n{rows(D)}"
        outer = f"R:\n{rows(rotation)}T:\n{rows(100 * translation[:, None])}"
        # As in handpose3d's own file, what its reader does not reach.
        outer += f"\n#below is rotation and translation to go from cam0 to cam1.\nR:\n{rows(np.eye(3))}"
        for name, text in zip(form, (inner, outer), strict=True):
            (folder / f"{name.format(n)}.dat").write_text(text)
    (folder / "world_to_camera0_rot_trans.dat").write_text("R:\n1 0 0\n0 1 0\n0 0 1\nT:\n9\n9\n9\n")
    return folder


@pytest.mark.parametrize("form", [("c{}", "rot_trans_c{}"), ("camera{}_intrinsics", "camera{}_rot_trans")])
@pytest.mark.parametrize("given", ["camera_parameters", "camera_parameters/{}.dat"])
def test_handposes_pairs(given: str, form: tuple[str, str], tmp_path: Path) -> None:
    handpose(tmp_path / "camera_parameters", form)
    said: list[str] = []
    names = "cam0_test", "cam1_test"
    found = read(tmp_path / given.format(form[1].format(1)), names, (640, 480), talk=said.append)
    assert said == [
        "camera_parameters states no unit of its lengths: cm is assumed; --unit mm says otherwise"
    ]
    for n, name in enumerate(names):
        rotation, translation = pose(n)
        seen, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(rotation)[0], translation, lens(n), D)
        np.testing.assert_allclose(pixels(found, name, POINTS), seen.reshape(-1, 2), atol=1e-6)


def test_a_file_that_handposes_pairs_lack_is_named(tmp_path: Path) -> None:
    (handpose(tmp_path / "camera_parameters") / "rot_trans_c1.dat").unlink()
    with pytest.raises(BadInputError, match="camera_parameters: camera 1 has no R"):
        read(tmp_path / "camera_parameters", ("cam0", "cam1"), (640, 480))


# DeepLabCut


def deeplabcut(folder: Path) -> Path:
    """A project's camera_matrix, as deeplabcut.calibrate_cameras writes it."""
    folder.mkdir()
    lenses: dict[str, Any] = {}
    for n, name in enumerate(("camera-1", "camera-2")):
        lenses[name] = {"mtx": lens(n), "dist": D[None], "imgpoints": [np.zeros((48, 1, 2), np.float32)]}
        (folder / f"{name}_intrinsic_params.pickle").write_bytes(pickle.dumps(lenses))
    rotation, translation = pose(1)
    images = [np.zeros((480, 640), np.uint8) for _ in range(2)]
    pair: dict[str, Any] = {f"cameraMatrix{n + 1}": lens(n) for n in range(2)}
    pair |= {f"distCoeffs{n + 1}": D[None] for n in range(2)}
    pair |= {"R": rotation, "T": translation[:, None], "E": np.eye(3), "R1": np.eye(3), "R2": np.eye(3)}
    pair |= {
        "P1": np.zeros((3, 4)),
        "roi1": (0, 0, 640, 480),
        "image_shape": [image.shape[::-1] for image in images],
    }
    path = folder / "stereo_params.pickle"
    path.write_bytes(pickle.dumps({"camera-1-camera-2": pair}))
    return path


@pytest.mark.parametrize("whole", [True, False])
def test_deeplabcuts_pair(whole: bool, tmp_path: Path) -> None:
    """cv2.stereoCalibrate's x_2 = R x_1 + T, in squares of the board, which objp counts."""
    path = deeplabcut(tmp_path / "camera_matrix")
    found = read(path.parent if whole else path, ("camera-1", "camera-2"), (640, 480))
    assert found.unit == "square"
    rotation, translation = pose(1)
    for n, (turn, shift) in enumerate(((np.eye(3), np.zeros(3)), (rotation, translation))):
        seen, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(turn)[0], shift, lens(n), D)
        np.testing.assert_allclose(pixels(found, f"camera-{n + 1}", POINTS), seen.reshape(-1, 2), atol=1e-6)


def test_deeplabcuts_first_camera_is_the_first_of_the_pairs_name(tmp_path: Path) -> None:
    path = deeplabcut(tmp_path / "camera_matrix")
    (pair,) = pickle.loads(path.read_bytes()).values()
    path.write_bytes(pickle.dumps({"side-front": pair}))
    found = read(path, ("front", "side"), (640, 480))
    np.testing.assert_allclose(pixels(found, "side", POINTS), cv2.projectPoints(
        POINTS, np.zeros(3), np.zeros(3), lens(0), D
    )[0].reshape(-1, 2), atol=1e-6)  # fmt: skip
    path.write_bytes(pickle.dumps({"a-b": {"T": 1}, "a-c": {"T": 2}}))
    with pytest.raises(BadInputError, match="has several pairs of cameras: a-b, a-c"):
        read(path, ("a", "c"), (640, 480))


@pytest.mark.parametrize("content", [{}, {"camera-1-camera-2": 3}, {"a": {1: np.eye(3)}}, [np.eye(3)]])
def test_pickles_that_are_no_pair(content: Any, tmp_path: Path) -> None:
    (tmp_path / "stereo_params.pickle").write_bytes(pickle.dumps(content))
    with pytest.raises(BadInputError, match=r"has no R and T|does not hold camera parameters"):
        read(tmp_path / "stereo_params.pickle", ("camera-1", "camera-2"), (640, 480))


# LLFF


def test_llffs_poses(tmp_path: Path) -> None:
    """NeRF's ray of a pixel is c2w [(i - W / 2) / f, -(j - H / 2) / f, -1], with load_llff.py's columns."""
    names = "cam00", "cam02", "cam10"
    rows = []
    for n in range(3):
        rotation, translation = pose(n)
        right, down, forward = rotation
        table = [down, right, -forward, -rotation.T @ translation, [480.0, 640.0, 500.0 + n]]
        rows.append([*np.array(table).T.ravel(), 1.0, 9.0])
    np.save(tmp_path / "poses_bounds.npy", np.array(rows))
    found = read(tmp_path / "poses_bounds.npy", names, (320, 240))
    assert found.unit == "arbitrary"
    for name, row in zip(names, rows, strict=True):
        matrix = np.array(row[:15]).reshape(3, 5)
        # load_llff.py: poses = concatenate([poses[:, 1:2, :], -poses[:, 0:1, :], poses[:, 2:, :]], 1)
        c2w = np.column_stack([matrix[:, 1], -matrix[:, 0], matrix[:, 2:4]])
        height, width, focal = matrix[:, 4]
        # COLMAP's pixels begin at a corner, ours at the first one's centre, and the images are half as large.
        i, j = 2 * (pixels(found, name, POINTS) + 0.5).T
        rays = c2w[:, :3] @ [(i - width / 2) / focal, -(j - height / 2) / focal, -np.ones(3)]
        away = POINTS.T - c2w[:, 3:]
        rays, away = rays / np.linalg.norm(rays, axis=0), away / np.linalg.norm(away, axis=0)
        np.testing.assert_allclose(rays, away, atol=1e-6)


def test_a_scene_of_llff_is_a_camera_an_image(tmp_path: Path) -> None:
    """Rows and images are in the order of the files' names; smaller copies lie beside."""
    for place in ("images", "images_4"):
        (tmp_path / place).mkdir()
        for n in (9, 10):
            (tmp_path / place / f"IMG_{n}.jpg").write_bytes(jpeg(n))
    np.save(tmp_path / "poses_bounds.npy", np.arange(3 * 17).reshape(3, 17))
    assert recognize_recording(tmp_path) is None
    np.save(tmp_path / "poses_bounds.npy", np.arange(2 * 17).reshape(2, 17))
    layout = recognize_recording(tmp_path)
    assert layout is not None
    assert [(source.label, len(source.numbers)) for source in layout.sources] == [("IMG_9", 1), ("IMG_10", 1)]
    views = layout.views
    assert views is not None
    assert [(name, view.size) for name, view in views.cameras.items() if isinstance(view, View)] == [
        ("IMG_10", (9, 4)),
        ("IMG_9", (26, 21)),
    ]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (np.zeros((3, 17)), "has the shape .3, 17., not a row of 17 numbers for each of 2 cameras"),
        (np.array([[{}]]), "cannot read .* as an array"),
        (np.array(3.0), "cannot read .* as an array"),
        (np.full((2, 17), np.nan), "cannot read .* as an array"),
        (np.full((2, 17), 1e200), "cannot read .* as an array .*numbers below 1e.12"),
        (b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }\n",
         "cannot read .* as an array"),
    ],
)  # fmt: skip
def test_arrays_that_are_no_poses(content: Any, said: str, tmp_path: Path) -> None:
    path = tmp_path / "poses_bounds.npy"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.save(path, content, allow_pickle=True)
    with pytest.raises(BadInputError, match=said):
        read(path, ("a", "b"), (640, 480))
