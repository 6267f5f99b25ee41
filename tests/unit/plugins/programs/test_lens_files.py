"""Calibrations of photogrammetry and robotics mean here what they mean there, by those programs' formulas.

Metashape: its manual, "Camera models"; a portion of a real cameras.xml from open-forest-
observatory/geograypher, tests/test_derived_cameras.py. RealityCapture: "RealityCapture XMP Camera Math" on
support.capturingreality.com. OpenSfM: "Geometric Models" on opensfm.org; a real lens of a GoPro. Kalibr:
"Yaml formats" of its wiki; a real camchain of a fisheye pair from csdn.net. ROS: sensor_msgs/CameraInfo; a
real pair of files. MATLAB: "MAT-File Format"; a real Calib_Results_stereo.mat (hoshinohikari/Double-target)
gives the numbers that scipy.io reads.
"""

import json
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.plugins.programs.opencv import matlab_arrays
from capture_app.session.format.calibration import Calibration
from capture_app.session.importing.calibrations import fit_calibration, read_views
from tests.unit.plugins.programs.known_rig import POINTS, SIZE, Array, D, lens, pose, read, see
from tests.unit.session.conftest import jpeg

K1, K2, P1, P2, K3 = D


def seen(n: int, distortion: Array = D) -> Array:
    """Where OpenCV has the points in a camera of the known rig."""
    rotation, translation = pose(n)
    pixels, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(rotation)[0], translation, lens(n), distortion)
    return np.asarray(pixels).reshape(-1, 2)


def check_rig(found: Calibration) -> None:
    for n, name in enumerate(("cam0", "cam1")):
        np.testing.assert_allclose(see(found.cameras[name]), seen(n), atol=1e-6)


# Metashape


def metashape(path: Path, sensor: str = "", camera: str = "", end: str = "", kind: str = "frame") -> Path:
    """The known rig as Metashape has it; lengths of the chunk are halves of a metre."""
    sensors = cameras = ""
    for n in range(2):
        (fx, _, cx), (_, fy, cy), _ = lens(n)
        rotation, translation = pose(n)
        place = np.column_stack([rotation.T, -rotation.T @ translation * 2])
        sensors += (
            f'<sensor id="{n}" type="{kind}"><resolution width="640" height="480"/>'
            f'<calibration type="{kind}">'
            f"<resolution width='640' height='480'/><f>{fy}</f><b1>{fx - fy}</b1><cx>{cx + 0.5 - 320}</cx>"
            f"<cy>{cy + 0.5 - 240}</cy><k1>{K1}</k1><k2>{K2}</k2><k3>{K3}</k3><p1>{P2}</p1><p2>{P1}</p2>"
            f"{sensor}</calibration></sensor>"
        )
        numbers = " ".join(map(str, [*place.ravel(), 0, 0, 0, 1]))
        cameras += f'<camera sensor_id="{n}" label="cam{n}.jpg"><transform>{numbers}</transform></camera>'
    path.write_text(
        '<?xml version="1.0"?>\n<document version="1.5.0"><chunk>'
        f"<sensors>{sensors}</sensors><cameras>{cameras}"
        f'<camera sensor_id="0" label="not aligned"/>{camera}</cameras>{end}</chunk></document>'
    )
    return path


def test_metashape(tmp_path: Path) -> None:
    scale = "<transform><scale>0.5</scale></transform>"
    found = read(metashape(tmp_path / "cameras.xml", end=scale))
    assert found.unit == "m"
    check_rig(found)
    assert read(metashape(tmp_path / "cameras.xml")).unit == "arbitrary"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"sensor": "<k4>0.1</k4>"}, r"cam0\.jpg has a lens of type frame with k4"),
        ({"sensor": "<b2>0.4</b2>"}, "skew of 0.4"),
        ({"kind": "spherical"}, "type spherical"),
        ({"camera": '<camera sensor_id="0" label="cam0"><transform>1</transform></camera>'}, "has 1 numbers"),
        ({"camera": '<camera sensor_id="7" label="a"><transform/></camera>'}, "a has no calibrated sensor"),
        ({"camera": '<camera component_id="1" label="a"><transform/></camera>'}, "2 components"),
        (
            {
                "camera": '<camera sensor_id="0" label="cam0.jpg"><transform>'
                "1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>"
            },
            r"not in one place .*labelled by the cameras' names",
        ),
    ],
)
def test_what_metashape_has_and_no_rig_of_ours_is_refused(
    change: dict[str, str], reason: str, tmp_path: Path
) -> None:
    with pytest.raises(BadInputError, match=reason):
        read(metashape(tmp_path / "cameras.xml", **change))


REAL_METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true"><sensors next_id="1">
<sensor id="0" label="M3M (12.29mm)" type="frame"><resolution width="5280" height="3956"/>
<property name="layer_index" value="0"/><calibration type="frame" class="adjusted">
<resolution width="5280" height="3956"/><f>3705.4728792737214</f><cx>11.6738523909</cx><cy>-27.7497969199</cy>
<b1>0.5262024073</b1><k1>-0.0919367147</k1><k2>-0.0762807468</k2><k3>0.1162639394</k3>
<p1>-0.0003134847</p1><p2>0.0001164035</p2></calibration></sensor></sensors>
<components next_id="1" active_id="0"><component id="0" label="Component 1"><transform>
<translation locked="true">-2499366.429888 -4256836.520906 4029217.965003</translation>
<scale locked="true">12.354192447331316</scale></transform></component></components>
<cameras next_id="816" next_group_id="2"><group id="0" label="Group 1" type="folder">
<camera id="0" sensor_id="0" component_id="0" label="/home/user/image_sets/000001-01/00/000001-01_00001.JPG">
<transform>-0.99988146 -0.00872749 0.01268391 7.04224697 -0.00842932 0.99969124 0.02337453 7.05403071
-0.01288400 0.02326485 -0.99964631 0.43561421 0 0 0 1</transform>
<orientation>1</orientation></camera></group></cameras>
</chunk></document>"""


def test_the_scale_of_a_chunk_whose_component_has_none(tmp_path: Path) -> None:
    path = metashape(tmp_path / "cameras.xml", end="<transform><scale>0.5</scale></transform>")
    path.write_text(
        path.read_text()
        .replace("<cameras>", '<components><component id="0"/></components><cameras>')
        .replace("<camera sensor_id", '<camera component_id="0" sensor_id')
    )
    assert read(path).unit == "m"


def test_xml_in_an_encoding_that_is_not_known_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cameras.xml"
    path.write_text('<?xml version="1.0" encoding="shift_jis"?><document/>')
    with pytest.raises(BadInputError, match="multi-byte encodings"):
        read(path)


def test_a_real_file_of_metashape(tmp_path: Path) -> None:
    (tmp_path / "cameras.xml").write_text(REAL_METASHAPE)
    name = "000001-01_00001"
    found = fit_calibration(read_views([("", tmp_path / "cameras.xml")], [name]), {name: (5280, 3956)})
    camera = found.cameras[name]
    assert (camera.fx, camera.cx) == pytest.approx((3705.9990816, 2651.1738523909))
    place = -np.array(camera.rotation).T @ camera.translation
    np.testing.assert_allclose(
        place, np.array([7.04224697, 7.05403071, 0.43561421]) * 12.354192447331316, 1e-6
    )


# RealityCapture


def xmp(path: Path, attributes: str, rotation: str, position: str, distortion: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description xcr:Version="3" xcr:PosePrior="locked" xcr:Coordinates="absolute" {attributes} '
        'xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">'
        f"<xcr:Rotation>{rotation}</xcr:Rotation><xcr:Position>{position}</xcr:Position>"
        f"<xcr:DistortionCoeficients>{distortion}</xcr:DistortionCoeficients>"
        "</rdf:Description></rdf:RDF></x:xmpmeta>"
    )
    return path


def realitycapture(folder: Path, model: str = "brown3t2", k4: float = 0.0) -> Path:
    for n in range(2):
        (fx, _, cx), (_, fy, cy), _ = lens(n)
        rotation, translation = pose(n)
        said = (
            f'xcr:DistortionModel="{model}" xcr:FocalLength35mm="{fx * 36 / 640}" xcr:Skew="0" '
            f'xcr:AspectRatio="{fy / fx}" xcr:PrincipalPointU="{(cx - 319.5) / 640}" '
            f'xcr:PrincipalPointV="{(cy - 239.5) / 640}"'
        )
        turn, place = (" ".join(map(str, of.ravel())) for of in (rotation, -rotation.T @ translation))
        xmp(folder / f"cam{n}.xmp", said, turn, place, f"{K1} {K2} {K3} {k4} {P2} {P1}")
        (folder / f"cam{n}.JPG").write_bytes(jpeg(n, *SIZE))
    return folder


def test_realitycapture(tmp_path: Path) -> None:
    folder = realitycapture(tmp_path / "cal")
    found = read(folder)
    assert found.unit == "arbitrary"
    check_rig(found)
    with pytest.raises(BadInputError, match="model division"):
        read(realitycapture(folder, model="division"))
    with pytest.raises(BadInputError, match=r"the distortion k4 = 0\.1"):
        read(realitycapture(folder, model="brown4", k4=0.1))
    (realitycapture(folder) / "cam1.JPG").unlink()
    with pytest.raises(BadInputError, match=r"cam1\.xmp has no image beside it"):
        read(folder)


def test_sidecars_of_another_program_are_no_calibration(tmp_path: Path) -> None:
    (tmp_path / "a.xmp").write_text('<x:xmpmeta xmlns:x="adobe:ns:meta/"><a/></x:xmpmeta>')
    with pytest.raises(BadInputError, match=r"not a calibration of a known format .*<x:xmpmeta>"):
        read(tmp_path / "a.xmp")


# OpenSfM

GOPRO: dict[str, Any] = {
    "projection_type": "brown", "width": 3000, "height": 4000, "focal_x": 0.5207834102328533,
    "focal_y": 0.5207834102328533, "c_x": -0.010331518981731644, "c_y": -0.0036169971231284,
    "k1": -0.10638507280457302, "k2": 0.06769290794144624, "p1": -0.0009394968204580917,
    "p2": -0.0007005575451251272, "k3": -0.005369531191619131,
}  # fmt: skip


def opensfm(path: Path, change: dict[str, Any] | None = None, parts: int = 1) -> Path:
    cameras, shots = {}, {}
    for n in range(2):
        (fx, _, cx), (_, fy, cy), _ = lens(n)
        rotation, translation = pose(n)
        cameras[f"v2 {n}"] = {
            "projection_type": "brown", "width": 640, "height": 480, "focal_x": fx / 640, "focal_y": fy / 640,
            "c_x": (cx - 319.5) / 640, "c_y": (cy - 239.5) / 640,
            "k1": K1, "k2": K2, "p1": P1, "p2": P2, "k3": K3,
        } | (change or {})  # fmt: skip
        turn = cv2.Rodrigues(rotation)[0].ravel().tolist()
        shots[f"cam{n}.jpg"] = {"camera": f"v2 {n}", "rotation": turn, "translation": translation.tolist()}
    path.write_text(json.dumps([{"cameras": cameras, "shots": shots, "points": {}}] * parts))
    return path


def test_opensfm(tmp_path: Path) -> None:
    path = tmp_path / "reconstruction.json"
    found = read(opensfm(path))
    assert found.unit == "arbitrary"
    check_rig(found)
    wide = {"projection_type": "fisheye", "focal": 0.4, "k1": 0.05, "k2": -0.01}
    camera = read(opensfm(path, wide)).cameras["cam0"]
    assert (camera.is_fisheye, camera.fx, camera.distortion) == (True, 256.0, (0.05, -0.01, K3, 0.0))
    with pytest.raises(BadInputError, match="type spherical"):
        read(opensfm(path, {"projection_type": "spherical"}))
    with pytest.raises(BadInputError, match="2 reconstructions"):
        read(opensfm(path, parts=2))
    with pytest.raises(BadInputError, match="images of 0x0 pixels"):
        read(opensfm(path, {"width": 0, "height": 0}))


def test_a_real_lens_of_opensfm(tmp_path: Path) -> None:
    """A point at the side of a portrait picture, by the formulas of "Geometric Models"."""
    path = tmp_path / "reconstruction.json"
    shot = {"camera": "gopro8", "rotation": [0.0, 0.0, 0.0], "translation": [0.0, 0.0, 0.0]}
    path.write_text(json.dumps([{"cameras": {"gopro8": GOPRO}, "shots": {"a.jpg": shot}}]))
    camera = fit_calibration(read_views([("", path)], ["a"]), {"a": (3000, 4000)}).cameras["a"]
    pixel, _ = cv2.projectPoints(
        np.array([[0.3, -0.2, 1.0]]),
        np.zeros(3),
        np.zeros(3),
        camera.matrix(3000, 4000),
        np.array(camera.distortion),
    )
    x, y, r2 = 0.3, -0.2, 0.13
    radial = 1 + GOPRO["k1"] * r2 + GOPRO["k2"] * r2**2 + GOPRO["k3"] * r2**3
    u = (
        GOPRO["focal_x"] * (x * radial + 2 * GOPRO["p1"] * x * y + GOPRO["p2"] * (r2 + 2 * x * x))
        + GOPRO["c_x"]
    )
    v = (
        GOPRO["focal_y"] * (y * radial + 2 * GOPRO["p2"] * x * y + GOPRO["p1"] * (r2 + 2 * y * y))
        + GOPRO["c_y"]
    )
    np.testing.assert_allclose(pixel.ravel(), [u * 4000 + 2999 / 2, v * 4000 + 3999 / 2])


# Kalibr

CAMCHAIN = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.2783471016021346, 0.6964790605940689, -1.7636165117280103,
    1.9185066948675424]
  distortion_model: equidistant
  intrinsics: [464.46660755800724, 465.36764628863784, 345.1018538803555, 229.48918054311704]
  resolution: [640, 480]
  rostopic: /left
cam1:
  T_cn_cnm1:
  - [0.9996465213666637, -0.02537787899957037, 0.007924366031799834, -0.11251195025612559]
  - [0.02547649136646326, 0.9995959921960228, -0.012601617884125324, -0.0017042839059835384]
  - [-0.0076013621922192826, 0.012799048524251695, 0.9998891956860474, -0.0005072054140188229]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [0.2682739040565608, 0.7579325851647005, -2.0708675842774156,
    2.3962970091118696]
  distortion_model: equidistant
  intrinsics: [461.8506067496413, 462.2467047389745, 325.2758830849641, 247.10152372631737]
  resolution: [640, 480]
  rostopic: /right
"""


def test_a_real_camchain_of_fisheyes(tmp_path: Path) -> None:
    path = tmp_path / "camchain-left.yaml"
    path.write_text(CAMCHAIN)
    for names in (("left", "right"), ("cam0", "cam1")):
        found = read(path, names=names)
        assert found.unit == "m"
        right = found.cameras[names[1]]
        assert right.is_fisheye
        assert right.distortion == (
            0.2682739040565608,
            0.7579325851647005,
            -2.0708675842774156,
            2.3962970091118696,
        )
        assert (right.fx, right.cx) == (461.8506067496413, 325.2758830849641)
        assert right.translation[0] == -0.11251195025612559


def test_a_chain_of_kalibr_adds_up(tmp_path: Path) -> None:
    """Each pose is that of the camera before, by number: in the file cam10 stands before cam2."""
    step = "  T_cn_cnm1: [[0,-1,0,1],[1,0,0,0],[0,0,1,0],[0,0,0,1]]\n"
    camera = "  camera_model: pinhole\n  distortion_model: none\n  intrinsics: [600, 600, 320, 240]\n"
    camera += "  resolution: [640, 480]\n"
    names = [f"cam{n}" for n in (0, 1, 10, 2)]
    path = tmp_path / "camchain.yaml"
    path.write_text("".join(f"{name}:\n{camera}{step * (name != 'cam0')}" for name in names))
    poses = [
        np.array(read(path, names=tuple(names)).cameras[name].translation)
        for name in ("cam1", "cam2", "cam10")
    ]
    np.testing.assert_allclose(poses, [[1, 0, 0], [1, 1, 0], [0, 1, 0]], atol=1e-12)
    path.write_text(path.read_text().replace("distortion_model", "distortion_coeffs: []\n  distortion_model"))
    assert read(path, names=tuple(names)).cameras["cam0"].distortion == (0, 0, 0, 0, 0)
    path.write_text(path.read_text().replace("pinhole", "omni"))
    with pytest.raises(BadInputError, match="cam0 is of Kalibr's model omni-none"):
        read(path)


# ROS

INFO = """image_width: 1312
image_height: 541
camera_name: narrow_stereo/{side}
camera_matrix:
  rows: 3
  cols: 3
  data: [{k}]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [{d}]
rectification_matrix:
  rows: 3
  cols: 3
  data: [{r}]
projection_matrix:
  rows: 3
  cols: 4
  data: [834.752703, 0.0, 612.806038, {tx}, 0.0, 834.752703, 158.305822, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
LEFT = {
    "k": "853.415831, 0.0, 641.228450, 0.0, 852.608357, 167.569232, 0.0, 0.0, 1.0",
    "d": "-0.251963, 0.096396, -0.002254, -0.001636, 0.0",
    "r": "0.999479, -0.000960, 0.032258, 0.000688, 0.999964, 0.008463, -0.032265, -0.008436, 0.999444",
    "tx": "0.0",
}
RIGHT = {
    "k": "851.257609, 0.0, 637.135422, 0.0, 851.168364, 154.698218, 0.0, 0.0, 1.0",
    "d": "-0.239563, 0.084455, -0.002111, -0.000161, 0.0",
    "r": "0.999997, -0.001336, 0.002140, 0.001354, 0.999963, -0.008449, -0.002129, 0.008452, 0.999962",
    "tx": "-190.372340",
}


def ros(folder: Path, right: dict[str, str] = RIGHT, text: str = INFO) -> Path:
    for side, of in (("left", LEFT), ("right", right)):
        (folder / f"{side}.yaml").write_text(text.format(side=side, **of))
    return folder


def test_a_real_pair_of_ros_meets_on_rectified_rows(tmp_path: Path) -> None:
    """Projected by our poses, undistorted and rectified by R and P, a point has one row and P's disparity."""
    sizes = dict.fromkeys(("left", "right"), (1312, 541))
    found = fit_calibration(read_views([("", ros(tmp_path))], [*sizes]), sizes)
    assert found.unit == "m"
    pixels = []
    for of, camera in zip((LEFT, RIGHT), found.cameras.values(), strict=True):
        k, d, r = (np.array([float(word) for word in of[key].split(",")]) for key in "kdr")
        p = np.array([[834.752703, 0, 612.806038], [0, 834.752703, 158.305822], [0, 0, 1]])
        seen_at = see(camera).reshape(-1, 1, 2)
        pixels.append(
            cv2.undistortPoints(seen_at, k.reshape(3, 3), d, None, r.reshape(3, 3), p).reshape(-1, 2)
        )
    np.testing.assert_allclose(pixels[0][:, 1], pixels[1][:, 1], atol=2e-3)
    np.testing.assert_allclose((pixels[0] - pixels[1])[:, 0], 190.372340 / POINTS[:, 2], atol=2e-3)


def test_what_ros_prints_is_read_too(tmp_path: Path) -> None:
    echo = "header:\n  frame_id: a\nheight: 541\nwidth: 1312\ndistortion_model: equidistant\n"
    echo += "D: [0.1, 0.0, 0.0, 0.0]\nK: [{k}]\nR: [{r}]\n"
    echo += "P: [834.7, 0, 612.8, {tx}, 0, 834.7, 158.3, 0, 0, 0, 1, 0]\n---\n"
    sizes = dict.fromkeys(("left", "right"), (1312, 541))
    files = [(side, ros(tmp_path, text=echo) / f"{side}.yaml") for side in sizes]
    found = fit_calibration(read_views(files, [*sizes]), sizes)
    assert found.cameras["right"].is_fisheye
    assert np.linalg.norm(found.cameras["right"].translation) == pytest.approx(190.372340 / 834.7, 1e-5)


@pytest.mark.parametrize(
    ("right", "text", "reason"),
    [
        ({"tx": "0.0"}, INFO, "were calibrated one by one"),
        (
            {"d": "0, 0, 0, 0, 0, 0.1, 0, 0"},
            INFO.replace("plumb_bob", "rational_polynomial"),
            "more terms than k1",
        ),
        ({}, INFO.replace("plumb_bob", "fov"), r"left\.yaml has a lens of model fov"),
        (
            {},
            INFO.replace("0.0, 834.752703, 158", "8.0, 834.752703, 158"),
            "P that",
        ),
        ({"k": "1, 2"}, INFO, "K has 2 numbers"),
    ],
)
def test_files_of_ros_that_are_no_pair(right: dict[str, str], text: str, reason: str, tmp_path: Path) -> None:
    sizes = dict.fromkeys(("left", "right"), (1312, 541))
    with pytest.raises(BadInputError, match=reason):
        fit_calibration(read_views([("", ros(tmp_path, RIGHT | right, text))], [*sizes]), sizes)


# MATLAB


def element(kind: int, body: bytes) -> bytes:
    return struct.pack("<II", kind, len(body)) + body + bytes(-len(body) % 8)


def variable(name: str, values: Array, *, packed: bool) -> bytes:
    """A double array, or one of whole numbers as MATLAB packs them; compressed or not."""
    numbers = values.astype(np.uint8 if packed else np.float64)
    short = struct.pack("<HH", 1, len(name)) + name.encode() + bytes(4 - len(name)) if len(name) < 5 else b""
    body = element(6, struct.pack("<II", 6, 0)) + element(5, np.array(values.shape, "<i4").tobytes())
    body += (short or element(1, name.encode())) + element(2 if packed else 9, numbers.tobytes(order="F"))
    if not packed:
        return element(14, body)
    data = zlib.compress(element(14, body))
    return struct.pack("<II", 15, len(data)) + data


def matlab(path: Path, arrays: dict[str, Array], *, head: bytes = b"MATLAB 5.0 MAT-file") -> Path:
    begin = head.ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
    path.write_bytes(begin + b"".join(variable(key, of, packed=key[:1] == "n") for key, of in arrays.items()))
    return path


@pytest.mark.parametrize("bouguet", [True, False])
def test_matlab(bouguet: bool, tmp_path: Path) -> None:
    rotation = pose(1)[0] @ pose(0)[0].T
    translation = pose(1)[1] - rotation @ pose(0)[1]
    names = "KK_left kc_left KK_right kc_right R T" if bouguet else (
        "intrinsicMatrix1 distortionCoefficients1 intrinsicMatrix2 distortionCoefficients2 "
        "rotationOfCamera2 translationOfCamera2"
    )  # fmt: skip
    values = (lens(0), D[:, None], lens(1), D[:, None], rotation, translation[:, None])
    arrays = dict(zip(names.split(), values, strict=True))
    arrays |= {"nx": np.array([[160]]), "ny": np.array([[100]])} if bouguet else {}
    path = matlab(tmp_path / "Calib_Results_stereo.mat", arrays)
    if bouguet:
        with pytest.raises(BadInputError, match="calibrated for 160x100"):
            read(path, names=("left", "right"))
    path = matlab(path, {key: of for key, of in arrays.items() if key[0] != "n"})
    found = read(path, names=("left", "right"), unit="in")
    np.testing.assert_allclose(found.cameras["right"].rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(found.cameras["right"].translation, translation * 0.0254)
    assert (found.cameras["left"].fx, found.cameras["right"].cx) == (lens(0)[0, 0], lens(1)[0, 2])
    np.testing.assert_allclose(found.cameras["left"].distortion, D)


@pytest.mark.parametrize("head", [b"MATLAB 7.3 MAT-file", b"MATLAB 5.0 MAT-file"])
def test_objects_of_matlab_are_refused_with_the_line_that_converts_them(head: bytes, tmp_path: Path) -> None:
    path = matlab(tmp_path / "stereoParams.mat", {"": np.zeros((1, 4))}, head=head)
    with pytest.raises(BadInputError, match="outside MATLAB") as refused:
        read(path)
    assert "stereoParametersToOpenCV(stereoParams)" in refused.value.hint


def test_a_large_variable_of_the_workspace_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matlab_arrays, "MAX_VARIABLE", 4096)
    path = matlab(tmp_path / "a.mat", {"n": np.zeros((100, 100)), "KK": lens(0)})
    assert list(matlab_arrays.read_mat(path)) == ["KK"]


def test_data_of_matlab_beside_files_of_opencv_is_none_of_theirs(tmp_path: Path) -> None:
    rotation = pose(1)[0] @ pose(0)[0].T
    for n, name in enumerate(("left", "right")):
        turn = rotation if n else np.eye(3)
        # nx and ny are the board's corners.
        np.savez(tmp_path / f"{name}.npz", mtx=lens(n), dist=D, nx=9, ny=6, R=turn, T=np.full(3, n))
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file")
    assert read(tmp_path, names=("left", "right")).cameras["left"].fx == lens(0)[0, 0]


# Others


def test_other_json_is_named_by_its_keys(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"poses": [], "views": []}')
    with pytest.raises(
        BadInputError, match=r"not a calibration of a known format \(its keys are poses, views\)"
    ):
        read(tmp_path / "a.json")
