"""A session's images as methods read them: their times, sizes, checks, and fisheyes redrawn straight."""

import shutil
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.common.picture_checksums import checked_pictures
from reconstruction.scene.dataset import Dataset, shift_times
from tests.unit.reconstruction.conftest import PERIOD_NS, VIEWS, Scene, write_session
from tests.unit.session.conftest import edit_manifest

PAIR = {name: VIEWS[name] for name in ("left", "right")}


@pytest.fixture(scope="module")
def pair(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Two cameras at three instants, with the truth."""
    return write_session(tmp_path_factory.mktemp("pair"), scene, PAIR, instants=3)


@pytest.fixture
def copied(pair: Session, tmp_path: Path) -> Session:
    return Session.open(shutil.copytree(pair.folder, tmp_path / "copy"))


def records(*at: tuple[str, int, int]) -> list[ImageRecord]:
    return [
        ImageRecord(
            camera=camera,
            instant=k,
            path=f"{camera}{k}",
            leader_ns=ns,
            exposure_start_ns=ns - 5,
            bytes=1,
            sha256="",
        )
        for camera, k, ns in at
    ]


def test_a_shifted_cameras_images_are_at_their_nearest_instants() -> None:
    times = (0, 100, 200, 300)
    own = records(*(("a", k, 100 * k) for k in range(4)), *(("b", k, 100 * k) for k in range(4)))
    placed = shift_times(own, {"a": 120e-6}, times, 100)
    assert {k: record.path for (camera, k), record in placed.items() if camera == "a"} == {
        1: "a0",
        2: "a1",
        3: "a2",
    }
    moved = placed["a", 2]
    assert (moved.leader_ns, moved.residual_ns, moved.exposure_start_ns, moved.instant) == (220, 20, 215, 1)
    assert placed["b", 2] == own[6]
    bare = [msgspec.structs.replace(record, exposure_start_ns=None) for record in own]
    assert shift_times(bare, {"a": 120e-6}, times, 100)["a", 2].exposure_start_ns is None
    assert shift_times(own, {"a": 0.0}, times, 100)["a", 1] == own[1]
    # Between two instants it is at neither, and at the end of the burst there are no more.
    assert ("a", 1) not in shift_times(own[:1], {"a": 0.0, "b": 0.0}, times, 100)
    with pytest.raises(BadInputError, match="--time-shift-ms a=9 leaves no image of a") as refused:
        shift_times(own, {"a": 9.0}, times, 100)
    assert refused.value.hint == "the burst is 0 ms long"


def test_images_that_are_missing_or_cut_are_named(copied: Session) -> None:
    image = copied.image_file(copied.manifest.images[1])
    data = image.read_bytes()
    image.write_bytes(data[:-9])
    with pytest.raises(IncompleteError, match=f"{image.name} has {len(data) - 9} bytes, not {len(data)}"):
        Dataset.open(copied.folder)
    image.unlink()
    with pytest.raises(IncompleteError, match=f"{image.name} is missing"):
        Dataset.open(copied.folder)


def test_instants_that_do_not_follow_each_other_are_refused(copied: Session) -> None:
    edit_manifest(copied, lambda manifest: manifest["burst"].update(instants_ns=[0, PERIOD_NS, PERIOD_NS]))
    with pytest.raises(BadInputError, match="has instants that do not follow each other in time"):
        Dataset.open(copied.folder)


@pytest.mark.parametrize(("kind", "changes"), [("cameras", {"cameras": []}), ("instants", {})])
def test_a_session_without_cameras_or_instants_is_refused(copied: Session, kind: str, changes: Any) -> None:
    def empty(manifest: Any) -> None:
        manifest.update(changes, images=[])
        manifest["burst"].update(instants_ns=[] if kind == "instants" else manifest["burst"]["instants_ns"])

    edit_manifest(copied, empty)
    (copied.folder / "calibration.json").unlink()
    with pytest.raises(BadInputError, match=f"has no {kind}"):
        Dataset.open(copied.folder)


def test_an_image_of_another_size_or_with_other_bytes_is_told(copied: Session) -> None:
    dataset = Dataset.open(copied.folder)
    record = copied.manifest.images[0]
    path = copied.image_file(record)
    image = np.asarray(cv2.imread(str(path)))
    with checked_pictures(required=True):
        dataset.image(record.camera, record.instant)
    path.write_bytes(cv2.imencode(".png", image[:200])[1].tobytes())
    with pytest.raises(BadInputError, match=f"{path} is 320x200, but {record.camera} is 320x240"):
        Dataset(copied).image(record.camera, record.instant)
    path.write_bytes(cv2.imencode(".png", np.rot90(image))[1].tobytes())
    with pytest.raises(BadInputError, match=f"{path} is 240x320, but {record.camera} is 320x240"):
        Dataset(copied).image(record.camera, record.instant)
    path.write_bytes(cv2.imencode(".png", image // 2)[1].tobytes())
    with checked_pictures(required=False) as checks:
        assert np.array_equal(Dataset(copied).image(record.camera, record.instant), image // 2)
    assert checks.changed == (str(path),)


def test_a_reduced_dataset_reduces_all(pair: Session) -> None:
    whole = Dataset(pair)
    half = whole.fitted(images=1)
    assert half is whole
    half._scale = 0.5
    half._read = half._image_cache()
    assert (half.size("left"), half.size_on_disk("left")) == ((160, 120), (320, 240))
    assert half.image("left", 1).shape == (120, 160, 3)
    truth, full = half.ground_truth("left", 1), Dataset(pair).ground_truth("left", 1)
    assert truth is not None
    assert full is not None
    assert (truth[0].shape, truth[1].dtype) == ((120, 160), bool)
    assert np.isin(truth[0], full[0]).all()
    assert truth[1].mean() == pytest.approx(full[1].mean(), rel=0.1)
    assert half.ground_truth("left", 9) is None
    assert half.ground_truth_file("left", 9) is None
    assert half.ground_truth_file("left", 1) is not None
    assert half.grey("left", 1).shape == (120, 160)


def fisheye(name: str, *, distortion: tuple[float, ...] = (0, 0, 0, 0)) -> View:
    plain = PAIR[name]
    matrix = np.array([[140.0, 0, 159.5], [0, 140, 119.5], [0, 0, 1]])
    return View(320, 240, matrix, np.array(distortion), plain.rotation, plain.translation, True)


def test_a_fisheyes_images_and_truth_are_redrawn_straight(
    pair: Session, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = Dataset(pair)
    plain = Calibration(cameras={name: view.to_calibration() for name, view in PAIR.items()})
    assert dataset.straightened(plain) is dataset
    assert dataset.straight_calibration(plain) == plain
    mixed = plain.cameras | {"left": fisheye("left").to_calibration()}
    bent = msgspec.structs.replace(plain, cameras=mixed)
    straight = dataset.straightened(bent)
    assert straight is not dataset
    said = capsys.readouterr().err
    assert "left is a fisheye: " in said
    assert " of its 131 degrees across are used" in said
    assert "right" not in said
    lens = straight.straight_calibration(bent).cameras["left"]
    assert not lens.is_fisheye
    assert straight.straight_calibration(bent).cameras["right"] == mixed["right"]
    assert np.array_equal(straight.image("right", 1), dataset.image("right", 1))
    assert not np.array_equal(straight.image("left", 1), dataset.image("left", 1))
    # A pixel of the straight image shows what its ray shows in the fisheye's.
    view, source = View.from_calibration(lens, 320, 240), fisheye("left")
    at = np.array([[200.0, 150.0], [60.0, 60.0], [160.0, 120.0]])
    there = np.rint(source.project(view.rays(at))).astype(int)
    image, original = straight.grey("left", 1).astype(int), dataset.grey("left", 1).astype(int)
    near = [original[y - 1 : y + 2, x - 1 : x + 2] for x, y in there]
    for (x, y), around in zip(at.astype(int), near, strict=True):
        assert around.min() - 12 <= image[y, x] <= around.max() + 12
    truth = straight.ground_truth("left", 1)
    assert truth is not None
    whole = dataset.ground_truth("left", 1)
    assert whole is not None
    assert (
        truth[0][150, 200] in whole[0][there[0][1] - 1 : there[0][1] + 2, there[0][0] - 1 : there[0][0] + 2]
    )
    assert straight.image_bytes("left", 1)[:4] == b"\x89PNG"
    assert np.array_equal(
        np.asarray(cv2.imdecode(np.frombuffer(straight.image_bytes("left", 1), np.uint8), 1)),
        straight.image("left", 1),
    )
    # A calibration that cannot be right, or of a camera that is not here, straightens nothing.
    wrong = msgspec.structs.replace(mixed["left"], fx=-1.0)
    assert dataset.straightened(msgspec.structs.replace(plain, cameras={"left": wrong})) is dataset
    assert dataset.straightened(msgspec.structs.replace(plain, cameras={"gone": mixed["left"]})) is dataset


def test_a_camera_that_a_shift_names_is_one_of_the_sessions(pair: Session) -> None:
    assert Dataset(pair, {"left": 33.0}).time_shifts_ms == {"left": 33.0}
    with pytest.raises(BadInputError, match="--time-shift-ms"):
        Dataset(pair, {"middle": 33.0})
