"""What may come with the pictures: points, masks, one instant only, videos without loss."""

import csv
import json
from pathlib import Path

import av
import cv2
import msgspec
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode, IncompleteError
from capture_app.plugins.programs.freemocap.freemocap_writer import camera_ids
from capture_app.session.exporting.csv_tables import yaml_names
from capture_app.session.exporting.point_cloud import PointCloud, read_ply, write_ply
from capture_app.session.format.lens import lens_of, rays_of, without_k3
from capture_app.session.reading.reader import Session
from tests.unit.plugins.programs.conftest import HEIGHT, WIDTH, Export, Make
from tests.unit.plugins.programs.dotted import lens

CLOUD = PointCloud(
    np.array([[0.5, -0.25, 1.0], [0.0, 0.125, -2.0], [3.0, 0.0, 0.0]]),
    np.array([[255, 0, 0], [1, 2, 3], [9, 8, 7]], np.uint8),
)


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    write_ply(tmp_path / "cloud.ply", CLOUD)
    return tmp_path / "cloud.ply"


@pytest.fixture
def whole(make: Make) -> Session:
    """A session with every image of every camera."""
    return make(missing=(), substitutes={})


def masks_of(session: Session, folder: Path) -> Path:
    """A mask for each image: white in the left third."""
    for image in session.manifest.images:
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[:, : WIDTH // 3] = 255
        target = folder / image.camera / f"{image.instant:06d}.png"
        target.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(target), mask)
    return folder


def test_masks_are_paired_with_cameras_by_their_labels(
    whole: Session, tmp_path: Path, export: Export
) -> None:
    """By the rule of calibrations and tables, one to one, and what was paired is said."""
    masks, out = masks_of(whole, tmp_path / "masks"), tmp_path / "out"
    export(whole, "colmap", masks=masks)
    expected = {path.relative_to(out): path.read_bytes() for path in out.rglob("masks/**/*.png")}
    assert len(expected) == 12
    out.rename(tmp_path / "first")
    for folder in [*masks.iterdir()]:
        folder.rename(masks / folder.name.upper())
    burst = export(whole, "colmap", masks=masks)
    assert {path.relative_to(out): path.read_bytes() for path in out.rglob("masks/**/*.png")} == expected
    assert sum("left = LEFT" in note for note in burst.notes) == 1


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"ply\nformat ascii 1.0\nend_header\n",
        b"ply\nelement vertex 0\nend_header\n",
        b"not a cloud",
        b"ply\nformat binary_little_endian 1.0\n",
    ],
)
def test_what_is_no_point_cloud(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(BadInputError, match=r"bad\.ply"):
        read_ply(tmp_path / "bad.ply")
    with pytest.raises(IncompleteError, match="is missing"):
        read_ply(tmp_path / "none.ply")


def test_masks_where_a_format_holds_them(whole: Session, export: Export, tmp_path: Path) -> None:
    masks, out = masks_of(whole, tmp_path / "masks"), tmp_path / "out"

    def shares(files: list[Path]) -> list[float]:
        assert files
        return [
            float(np.mean(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)[:, : WIDTH // 4])) for path in files
        ]

    export(whole, "nerfstudio", masks=masks)
    content = json.loads((out / "transforms.json").read_text())
    # Black is left out of the losses: what moves.
    assert shares([out / frame["mask_path"] for frame in content["frames"]]) == [0.0] * 12
    out.rename(tmp_path / "first")
    export(whole, "colmap", masks=masks)
    names = sorted(str(path.relative_to(out / "images")) for path in (out / "images").rglob("*.jpg"))
    assert shares([out / "masks" / f"{name}.png" for name in names]) == [0.0] * 12
    out.rename(tmp_path / "second")
    export(whole, "easyvolcap", masks=masks)
    # White is the foreground.
    assert shares(sorted((out / "masks").rglob("*.png"))) == pytest.approx([255.0] * 12, abs=1)
    (masks / "mid" / "000002.png").unlink()
    out.rename(tmp_path / "third")
    with pytest.raises(IncompleteError, match=r"mid/000002\.png is missing"):
        export(whole, "colmap", masks=masks)


def test_one_instant(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    report = export(session, "nerfstudio", instant=3)
    content = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert {frame["instant"] for frame in content["frames"]} == {3}
    assert {frame["time"] for frame in content["frames"]} == {0.0}
    assert len(report.images) == 3
    rows = list(csv.DictReader((tmp_path / "out" / "frames.csv").read_text().splitlines()))
    contents = {(row["camera"], int(row["instant"])): row["content"] for row in rows}
    assert [contents["left", instant] for instant in range(4)] == ["left out"] * 3 + ["image"]
    assert contents["right", 1] == "missing"
    (tmp_path / "out").rename(tmp_path / "first")
    export(session, "colmap", instant=3)
    found = sorted((tmp_path / "out" / "images").rglob("*.jpg"))
    assert {path.name for path in found} == {"000003.jpg"}
    (tmp_path / "out").rename(tmp_path / "second")
    with pytest.raises(BadInputError, match="no image of instant 4"):
        export(session, "nerfstudio", instant=4)
    with pytest.raises(BadInputError, match="mp4 takes no --instant"):
        export(session, "mp4", instant=0)


def test_all_instants_at_once_are_said(make: Make, export: Export) -> None:
    assert any("--instant" in note for note in export(make(), "nerfstudio").notes)


@pytest.mark.parametrize("width", [96, 81])
def test_videos_without_loss(make: Make, export: Export, tmp_path: Path, width: int) -> None:
    session = make(sizes=dict.fromkeys(("left", "mid", "right"), (width, 64)), calibrate=())
    export(session, "mp4", lossless=True)
    for camera in ("left", "right"):
        files = sorted((session.folder / "images" / "rig1" / camera).iterdir())
        with av.open(str(tmp_path / "out" / f"{camera}.mp4")) as container:
            shown = [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]
        assert len(shown) == len(files)
        for picture, file in zip(shown, files, strict=True):
            assert np.array_equal(picture, cv2.imread(str(file)))


def test_easyvolcap_counts_the_instants_that_all_have(make: Make, export: Export, tmp_path: Path) -> None:
    report = export(make(), "easyvolcap")
    for camera in ("left", "mid", "right"):
        found = sorted(path.name for path in (tmp_path / "out" / "images" / camera).iterdir())
        assert found == ["000000.jpg", "000001.jpg"]
    assert any("left out" in note for note in report.notes)
    assert any("without distortion" in note for note in report.notes)


def test_names_that_files_and_keys_can_hold() -> None:
    assert yaml_names(["left", "a.b"]) == {"a.b": "a_b", "left": "left"}
    assert len(set(yaml_names(["a.b", "a_b"]).values())) == 2
    assert camera_ids(("left", "right"), "take") == {"left": "left", "right": "right"}
    assert "." not in "".join(camera_ids(("a.b", "c"), "take").values())
    # cam-b.mp4 would come before cam.mp4, but the table cam before cam-b.
    assert list(camera_ids(("cam", "cam-b"), "take").values()) == ["cam_000", "cam_001"]


def test_the_nearest_lens_without_k3() -> None:
    given = lens("cam10")
    fitted, worst_px = without_k3(given)
    rows, columns = np.mgrid[0 : given.height : 16, 0 : given.width : 16]
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(float)
    every = rays_of(given, pixels)
    inside = ~np.isnan(every).any(axis=1)
    # A few in the corners are past the lens's turning point.
    assert 0.9 < inside.mean() < 1
    rays = every[inside]
    assert lens_of(given).project(rays) == pytest.approx(pixels[inside], abs=1e-5)
    apart = np.linalg.norm(lens_of(fitted).project(rays) - lens_of(given).project(rays), axis=1)
    assert apart.max() <= worst_px
    dropped = np.linalg.norm(
        lens_of(msgspec.structs.replace(given, distortion=(*given.distortion[:4], 0.0))).project(rays)
        - lens_of(given).project(rays),
        axis=1,
    )
    assert apart.max() < dropped.max() / 2
    assert without_k3(fitted) == (fitted, 0.0)


def test_the_options_of_the_command(
    make: Make, tmp_path: Path, cloud: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(make().folder)
    arguments = ["sessions", "export", folder, "--to", "nerfstudio", "--instant", "0", "--points", str(cloud)]
    assert run([*arguments, "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "sparse_pc.ply").is_file()
    arguments = [
        "sessions",
        "export",
        folder,
        "--to",
        "easymocap",
        "--lossless",
        "--out",
        str(tmp_path / "second"),
    ]
    assert run(arguments) == 0
    assert (tmp_path / "second" / "intri.yml").is_file()
    capsys.readouterr()
    refused = [
        "sessions",
        "export",
        folder,
        "--to",
        "mp4",
        "--masks",
        str(tmp_path),
        "--out",
        str(tmp_path / "x"),
    ]
    assert run(refused) == ExitCode.BAD_INPUT
    assert "mp4 takes no --masks" in capsys.readouterr().err
