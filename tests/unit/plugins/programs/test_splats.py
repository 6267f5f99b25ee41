"""Exports for trainers of Gaussian splats, read by the layouts that these programs document."""

import json
import struct
from pathlib import Path
from typing import Any, NamedTuple

import cv2  # before pycolmap
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.companions.exporting.export_session import export_session
from capture_app.session.exporting.pinhole import common_pinhole, nearest_pinhole
from capture_app.session.exporting.point_cloud import PointCloud, read_ply, write_ply
from capture_app.session.exporting.starting_points import match_points
from capture_app.session.format.calibration import CameraCalibration
from tests.unit.plugins.programs.conftest import POINT, Export, Make, calibrated, picture, spot
from tests.unit.plugins.programs.dotted import build, lens

COMPLETE = (0, 3)
"""The instants of the session that every camera has."""
CAMERAS = ("left", "mid", "right")


class Seen(NamedTuple):
    """An image of a sparse model: its camera (width, height, fx, fy, cx, cy), pose and points."""

    name: str
    camera: tuple[float, ...]
    pose: Any
    pixels: Any
    points: Any

    def project(self, points: Any, centred: bool = False) -> Any:
        """Pixels of points, the first pixel's centre at 0.5; 3DGS takes the image's centre for cx and cy."""
        width, height, fx, fy, cx, cy = self.camera
        if centred:
            cx, cy = width / 2, height / 2
        x, y, z = (np.atleast_2d(points) @ self.pose[:, :3].T + self.pose[:, 3]).T
        return np.stack([fx * x / z + cx, fy * y / z + cy], axis=1)


def unpack(file: Any, code: str) -> tuple[Any, ...]:
    return struct.unpack(f"<{code}", file.read(struct.calcsize(f"<{code}")))


def read_model(folder: Path) -> tuple[list[Seen], Any, list[list[tuple[int, int]]]]:
    """Read a model by COLMAP's documented binary format: images, points, tracks. Only PINHOLE is known."""
    cameras = {}
    with (folder / "cameras.bin").open("rb") as file:
        for _ in range(*unpack(file, "Q")):
            number, model, width, height = unpack(file, "IiQQ")
            assert model == 1, "not PINHOLE"
            cameras[number] = (width, height, *unpack(file, "4d"))
        assert not file.read()
    images = []
    with (folder / "images.bin").open("rb") as file:
        for _ in range(*unpack(file, "Q")):
            _, w, x, y, z, *shift, camera = unpack(file, "I7dI")
            name = b""
            while (byte := file.read(1)) != b"\0":
                name += byte
            rows = np.frombuffer(file.read(24 * unpack(file, "Q")[0]), "<f8,<f8,<u8")
            turn = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
                ]
            )
            pixels = np.stack([rows["f0"], rows["f1"]], axis=1)
            pose = np.column_stack([turn, shift])
            images.append(Seen(name.decode(), cameras[camera], pose, pixels, rows["f2"]))
        assert not file.read()
    points, tracks = [], []
    with (folder / "points3D.bin").open("rb") as file:
        for number in range(*unpack(file, "Q")):
            assert unpack(file, "Q") == (number + 1,)
            points.append(unpack(file, "3d"))
            *_, length = unpack(file, "3BdQ")
            tracks.append([unpack(file, "II") for _ in range(length)])
        assert not file.read()
    return images, np.array(points), tracks


def few_points(folder: Path) -> Path:
    """A cloud, so that no points need to be matched."""
    write_ply(folder / "few.ply", PointCloud(POINT + 0.01 * np.eye(3), np.full((3, 3), 90, np.uint8)))
    return folder / "few.ply"


def test_a_reader_of_3dgs_kind_opens_it(make: Make, export: Export, tmp_path: Path) -> None:
    burst = export(make(), "splats")
    out = tmp_path / "out"
    images, points, tracks = read_model(out / "sparse/0")
    assert {image.name for image in images} == {f"{name}_000003.jpg" for name in CAMERAS}
    assert 1000 <= len(points) <= 1002
    for number, image in enumerate(images, 1):
        shown = cv2.imread(str(out / "images" / Path(image.name).name))
        assert (shown.shape[1], shown.shape[0]) == image.camera[:2]
        assert np.abs(image.project(points[image.points.astype(int) - 1]) - image.pixels).max() < 1e-6
        for order, point in enumerate(image.points):
            assert (number, order) in tracks[int(point) - 1]
    assert any("left: " not in note and "cropped" in note and "left" in note for note in burst.notes)
    assert "resampled without distortion: mid, right" in burst.notes


def test_points_are_where_the_images_show_them(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(), "splats", lossless=True, instant=0)
    for image in read_model(tmp_path / "out/sparse/0")[0]:
        name = image.name.split("_")[0]
        own = calibrated(name)
        near = POINT + np.random.default_rng(0).uniform(-0.1, 0.1, (1000, 3))
        if name == "left":  # cropped by whole pixels, and not resampled
            shift = image.project(near) - [np.add(spot(own, point), 0.5) for point in near]
            assert np.abs(shift - np.rint(shift)).max() < 1e-6
            assert np.array_equal(np.rint(shift).max(axis=0), np.rint(shift).min(axis=0))
            left, top = -np.rint(shift[0]).astype(int)
            whole = cv2.imread(str(next((tmp_path / "sessions").rglob("left/000000.jpg"))))
            shown = cv2.imread(str(tmp_path / "out/images" / image.name))
            assert np.array_equal(shown, whole[top : top + shown.shape[0], left : left + shown.shape[1]])
        off = np.abs(image.project(near, centred=True) - image.project(near)).max()
        assert off < (0.251 if name == "left" else 1e-9)


def test_pycolmap_reads_it(make: Make, export: Export, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    export(make(), "splats")
    model = pycolmap.Reconstruction(str(tmp_path / "out/sparse/0"))
    assert model.num_reg_images() == 3
    assert {camera.model.name for camera in model.cameras.values()} == {"PINHOLE"}
    for image in model.images.values():
        for point in image.points2D:
            seen = image.project_point(model.points3D[point.point3D_id].xyz)
            assert seen == pytest.approx(point.xy, abs=1e-6)


def test_a_folder_of_each_instant_with_its_own_cloud(make: Make, export: Export, tmp_path: Path) -> None:
    for instant in COMPLETE:
        cloud = PointCloud(POINT + 0.01 * np.eye(3) * instant, np.full((3, 3), 40 + instant, np.uint8))
        write_ply(tmp_path / f"made/clouds/{instant:06d}.ply", cloud)
    burst = export(make(), "splats", layout="per-instant", points=tmp_path / "made")
    assert "left out: 2 instants that not every camera has" in burst.notes
    assert not any("matched" in note for note in burst.notes)
    for instant in COMPLETE:
        part = tmp_path / f"out/{instant:06d}"
        images, points, _ = read_model(part / "sparse/0")
        assert points == pytest.approx(POINT + 0.01 * np.eye(3) * instant, abs=1e-6)
        names = {path.name for path in (part / "images").iterdir()}
        assert names == {image.name for image in images} == {f"{name}_{instant:06d}.jpg" for name in CAMERAS}
    assert not (tmp_path / "out/000001").exists()


def test_4dgaussians_reads_multipleview(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(), "splats", layout="multipleview")
    out = tmp_path / "out"
    images, points, _ = read_model(out / "sparse_")
    for image in images:  # its reader finds the folder by the name, and takes the first camera's focal length
        folder = out / f"cam{Path(image.name).name[5:-4].zfill(2)}"
        assert sorted(path.name for path in folder.iterdir()) == ["frame_00001.jpg", "frame_00002.jpg"]
        assert image.camera == images[0].camera
        assert image.camera[2] == image.camera[3]
    assert len(read_ply(out / "points3D_multipleview.ply").points) == len(points)
    rows = np.load(out / "poses_bounds_multipleview.npy")
    assert rows.shape == (3, 17)
    assert rows[0, :15].reshape(3, 5)[:, 3] == pytest.approx(-images[0].pose[:, :3].T @ images[0].pose[:, 3])


def test_4c4d_has_png_images_of_all_frames_and_a_model_of_the_first(
    make: Make, export: Export, tmp_path: Path
) -> None:
    export(make(), "splats", layout="4c4d", masks=None)
    out = tmp_path / "out"
    names = {f"cam{camera:02d}_{frame:04d}.png" for camera in range(3) for frame in range(2)}
    assert {path.name for path in (out / "images").iterdir()} == names
    images, _, _ = read_model(out / "sparse/0")
    assert {image.name for image in images} == {name for name in names if name.endswith("_0000.png")}


def test_d_nerf_reads_square_images_with_one_angle(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(substitutes={}), "splats", layout="blender", points=few_points(tmp_path))
    out = tmp_path / "out"
    train, test = (json.loads((out / f"transforms_{part}.json").read_text()) for part in ("train", "test"))
    assert len(train["frames"]) == 9
    assert [frame["time"] for frame in test["frames"]] == pytest.approx([0.0, 0.4, 1.0]), "with the hole"
    focal = 400 / np.tan(train["camera_angle_x"] / 2)
    for frame in train["frames"]:
        shown = cv2.imread(str(out / f"{frame['file_path']}.png"))
        assert shown.shape == (800, 800, 3)
        x, y, z, _ = np.linalg.inv(frame["transform_matrix"]) @ [*POINT, 1.0]
        pixel = np.rint([400 - focal * x / z - 0.5, 400 + focal * y / z - 0.5]).astype(int)
        assert shown[pixel[1], pixel[0], 0] > 225
    assert len(read_ply(out / "fused.ply").points) == len(read_ply(out / "points3d.ply").points)


def test_cameras_as_gltf(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(unit="mm"), "splats")
    content = json.loads((tmp_path / "out/cameras.gltf").read_text())
    rig, *nodes = content["nodes"]
    assert [node["name"] for node in nodes] == [*CAMERAS, "points"]
    upright = np.array(rig["matrix"]).reshape(4, 4).T
    images = read_model(tmp_path / "out/sparse/0")[0]
    for node, image in zip(nodes, images, strict=False):
        perspective = content["cameras"][node["camera"]]["perspective"]
        pose = upright @ np.array(node["matrix"]).reshape(4, 4).T
        point = np.linalg.inv(pose) @ upright @ [*(POINT * 0.001), 1.0]
        y = 1 / np.tan(perspective["yfov"] / 2) * point[1] / -point[2]
        x = 1 / np.tan(perspective["yfov"] / 2) / perspective["aspectRatio"] * point[0] / -point[2]
        width, height = image.camera[:2]
        pixel = np.array([(1 + x) * width / 2, (1 - y) * height / 2])
        assert pixel == pytest.approx(image.project(POINT, centred=True)[0], abs=1e-6)
    view = content["bufferViews"][0]
    assert view["byteLength"] == 12 * content["accessors"][0]["count"] >= 12_000


def test_points_are_thinned_and_masks_lie_beside(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    write_ply(tmp_path / "cloud.ply", PointCloud(POINT + np.zeros((50, 3)), np.full((50, 3), 9, np.uint8)))
    for camera in CAMERAS:
        mask = np.zeros((64, 96), np.uint8)
        mask[20:40, 30:60] = 255
        (tmp_path / "masks" / camera).mkdir(parents=True)
        cv2.imwrite(str(tmp_path / f"masks/{camera}/000000.png"), mask)
    given = {"points": tmp_path / "cloud.ply", "max_points": 20, "masks": tmp_path / "masks", "instant": 0}
    export(session, "splats", **given)
    images, points, _ = read_model(tmp_path / "out/sparse/0")
    assert len(points) == 20
    for image in images:
        mask = cv2.imread(str(tmp_path / f"out/masks/{Path(image.name).stem}.png"), cv2.IMREAD_GRAYSCALE)
        assert (mask.shape[1], mask.shape[0]) == image.camera[:2]
        assert 0.05 < (mask == 255).mean() < 0.4


def test_what_a_trainer_stumbles_over_is_said_first(make: Make, tmp_path: Path) -> None:
    def refused(error: type[Exception], text: str, session: Any, **options: Any) -> None:
        with pytest.raises(error, match=text):
            export_session(session, "splats", tmp_path / "out", **options)
        assert not (tmp_path / "out").exists()

    refused(BadInputError, "no calibration", make(name="bare", calibrate=()))
    refused(IncompleteError, r"000003.ply is missing", make(name="clap2"), points=tmp_path)
    warnings: list[str] = []
    session = make(name="clap3", sizes={"left": (80, 64)})

    def warn(note: str) -> None:
        assert not list(tmp_path.rglob("*.bin"))
        warnings.append(note)

    export_session(session, "splats", tmp_path / "out", on_warning=warn)
    assert any("differ in size" in note for note in warnings)
    assert any("instant 3 alone" in note for note in warnings)


def test_two_cameras_are_few(tmp_path: Path) -> None:
    warnings: list[str] = []
    few: dict[str, Any] = {"points": few_points(tmp_path), "on_warning": warnings.append}
    export_session(build(tmp_path / "s"), "splats", tmp_path / "out", **few)
    assert any("two cameras" in note for note in warnings)


def test_lenses_that_are_alike_keep_their_images() -> None:
    camera = calibrated("left")
    square = CameraCalibration(
        width=96, height=64, fx=90, fy=90, cx=47.6, cy=31.5,
        rotation=camera.rotation, translation=camera.translation,
    )  # fmt: skip
    assert common_pinhole({"a": square, "b": square}) == {"a": square, "b": square}
    drawn = common_pinhole({"a": square, "b": lens("cam9")})
    assert {(one.width, one.height, one.cx) for one in drawn.values()} == {(96, 64, 47.5)}
    assert nearest_pinhole(square) == square


def test_a_picture_without_detail_has_no_points() -> None:
    cameras = {name: calibrated(name) for name in ("left", "mid")}
    flat = {name: np.full_like(picture(name, 0), 90) for name in cameras}
    assert len(match_points(cameras, flat).points) == 0
