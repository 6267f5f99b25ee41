"""Labels belong to the images of their frames, whatever an import cut or shifted; others are refused."""

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.format.common_times import REFERENCE, CameraTimes
from capture_app.session.importing.realigning import realign_session, repair_drops
from capture_app.session.reading.reader import Session
from reconstruction.methods.people.joint_files import read_keypoints
from reconstruction.scene.dataset import Dataset
from tests.imported import import_one

CAMERAS, FRAMES, PERIOD_NS = ("left", "right"), 20, 100_000_000


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras' images; frame k is 10 k grey levels bright."""
    folder = tmp_path_factory.mktemp("film")
    for camera in CAMERAS:
        (folder / camera).mkdir()
        for k in range(FRAMES):
            cv2.imwrite(str(folder / camera / f"{k:03}.png"), np.full((48, 64), 10 * k, np.uint8))
    return folder


def label(folder: Path, frames: Sequence[int] = range(FRAMES), shown: Sequence[int] = ()) -> Path:
    """Write labels as DeepLabCut does: in frame k, a point is at x = k, or at what `shown` says."""
    heads = ["scorer,net,net,net", "bodyparts,nose,nose,nose", "coords,x,y,likelihood"]
    folder.mkdir(exist_ok=True)
    rows = [f"{k},{x},2,0.9" for k, x in zip(frames, shown or frames, strict=True)]
    for camera in CAMERAS:
        (folder / f"{camera}.csv").write_text("\n".join([*heads, *rows]) + "\n")
    return folder


def paired(dataset: Dataset, labels: Path, start: str = "auto") -> int:
    """Return the number of labels, each of which must be of the frame that its image shows."""
    found = read_keypoints(labels, dataset, CAMERAS, start).cameras
    shown = {
        (camera, k): round(float(dataset.image(camera, k).mean()) / 10)
        for camera in CAMERAS
        for k in dataset.instants(camera)
    }
    said = {
        (camera, k): round(float(one.pixels[0, 0, 0]))
        for camera, frames in found.items()
        for k, one in frames.items()
    }
    assert said == {place: shown[place] for place in said}
    return len(said)


def opened(film: Path, folder: Path, **options: object) -> Session:
    chosen = ImportOptions(**{"fps": 10, "align": "none", **options})  # type: ignore[arg-type]
    return import_one([str(film)], folder, "s", chosen)


Change = Callable[[Session], Session]


def slower(session: Session) -> Session:
    """The session with a camera's clock set 0.3 s later, as sound, motion and light do."""
    exact = CameraTimes(offset_ns=0, uncertainty_ns=0, source=REFERENCE)
    late = CameraTimes(offset_ns=3 * PERIOD_NS, uncertainty_ns=1000, source="sound")
    return realign_session(session, {"left": exact, "right": late}, "sound")


def dropped(session: Session) -> Session:
    """The session with a hole in one camera, before its seventh image."""
    return repair_drops(session, {"right": [(6, 1)]})


@pytest.mark.parametrize(
    ("options", "change", "labelled"),
    [
        ({}, None, 40),
        ({"start": 5}, None, 30),
        ({"start": 5, "count": 4}, None, 8),
        ({"every": 2}, None, 20),
        ({"start": 3, "every": 3}, None, 12),
        ({"offsets_ms": {"right": 195.0}}, None, 40),
        ({"offsets_ms": {"right": -295.0}, "start": 4}, None, 35),
        ({}, slower, 40),
        ({"start": 2, "every": 2}, slower, 18),
        ({}, dropped, 40),
    ],
)
def test_labels_of_the_whole_film_fit_each_import(
    film: Path, tmp_path: Path, options: dict[str, object], change: Change | None, labelled: int
) -> None:
    session = opened(film, tmp_path, **options)
    session = change(session) if change else session
    assert paired(Dataset(session), label(tmp_path / "labels")) == labelled


def test_a_shift_for_one_command_moves_the_labels_with_their_images(film: Path, tmp_path: Path) -> None:
    dataset = Dataset(opened(film, tmp_path, start=4), {"right": 200.0})
    assert paired(dataset, label(tmp_path / "labels")) == 30


@pytest.mark.parametrize("options", [{"start": 5}, {"every": 2}])
def test_labels_of_a_cut_film_are_refused_with_both_numbers(
    film: Path, tmp_path: Path, options: dict[str, object]
) -> None:
    dataset = Dataset(opened(film, tmp_path, **options))
    shown = [dataset.record("left", k).sequence for k in dataset.instants("left")]
    labels = label(tmp_path / "labels", range(len(shown)), shown)
    with pytest.raises(
        BadInputError, match=rf"0 to {len(shown) - 1}, but .* {shown[0]} to {shown[-1]} of the 20"
    ):
        paired(dataset, labels)
    assert paired(dataset, labels, "session") == 2 * len(shown)
    if "start" in options:
        assert paired(dataset, labels, "-5") == 2 * len(shown)


def test_labels_that_are_counted_from_one_are_known_by_the_last(film: Path, tmp_path: Path) -> None:
    dataset = Dataset(opened(film, tmp_path, start=5))
    assert paired(dataset, label(tmp_path / "labels", range(1, 21), range(20))) == 30


@pytest.mark.parametrize(
    "numbers", [range(FRAMES + 1), range(100, 120), range(1, 11), [*range(10), *range(10)]]
)
def test_labels_that_may_be_of_other_frames_are_refused(
    film: Path, tmp_path: Path, numbers: Sequence[int]
) -> None:
    dataset = Dataset(opened(film, tmp_path))
    with pytest.raises(BadInputError, match="but the session has frames 0 to 19 of the 20") as raised:
        read_keypoints(label(tmp_path / "labels", numbers), dataset, CAMERAS)
    assert "--label-start" in raised.value.hint


def test_the_first_frames_number_can_be_given(film: Path, tmp_path: Path) -> None:
    dataset = Dataset(opened(film, tmp_path, start=2))
    assert paired(dataset, label(tmp_path / "labels", range(100, 120), range(20)), "100") == 36
    with pytest.raises(BadInputError, match="--label-start one is not"):
        read_keypoints(tmp_path / "labels", dataset, CAMERAS, "one")
