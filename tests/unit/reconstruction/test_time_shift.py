"""Corrected times pair a camera's images anew."""

from pathlib import Path

import pytest

from capture_app.session.reading.reader import Session
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import PERIOD_NS, VIEWS, Reconstruct, Scene, write_session

FRAME_MS = PERIOD_NS / 1e6
PAIR = {name: VIEWS[name] for name in ("left", "right")}


@pytest.fixture(scope="module")
def late(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A pair whose right camera is a frame later than its times say."""
    return write_session(tmp_path_factory.mktemp("late"), scene, PAIR, late={"right": 1.0})


def test_a_whole_frame_moves_images_to_the_next_instant(boards: Session) -> None:
    plain, shifted = Dataset.open(boards.folder), Dataset.open(boards.folder, {"right": FRAME_MS})
    assert shifted.instants("right") == (1, 2, 3, 4)
    assert shifted.instants("left") == plain.instants("left")
    for k in (1, 4):
        assert (shifted.grey("right", k) == plain.grey("right", k - 1)).all()
        true = plain.ground_truth("right", k - 1)
        moved = shifted.ground_truth("right", k)
        assert true is not None
        assert moved is not None
        assert (moved[0] == true[0]).all()
    assert shifted.fingerprint(None) != plain.fingerprint(None)


def test_less_than_half_a_frame_keeps_the_pairs_and_changes_the_times(boards: Session) -> None:
    shifted = Dataset.open(boards.folder, {"right": -0.4 * FRAME_MS})
    assert shifted.instants("right") == (0, 1, 2, 3, 4)
    record = shifted.record("right", 2)
    assert record.leader_ns - shifted.instants_ns[2] == pytest.approx(-0.4 * PERIOD_NS, abs=1)


@pytest.mark.parametrize(
    ("shift", "code", "words"),
    [
        ("nobody=5", 3, "--time-shift-ms names nobody, which the recording lacks"),
        ("right=900", 3, "leaves no image of right"),
        ("right", 2, "CAMERA=MS"),
        ("right=nan", 2, "CAMERA=MS"),
    ],
)
def test_a_shift_that_cannot_be_is_refused_in_one_line(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct, shift: str, code: int, words: str
) -> None:
    done = reconstruct("tolerance", boards.folder, "--time-shift-ms", shift, "--out", tmp_path / "out")
    assert done.code == code
    assert words in done.complaint


def test_pictures_by_themselves_have_no_times(
    late: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    pictures = late.folder / "images" / "rig1" / "left"
    done = reconstruct("panorama", pictures, "--time-shift-ms", "left=5", "--out", tmp_path / "out")
    assert "--time-shift-ms needs a session" in done.complaint
