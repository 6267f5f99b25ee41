"""Images of cameras that dropped or repeated frames are paired again."""

from pathlib import Path

import numpy as np
import pytest

from capture_app.common.errors import NotApplicableError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.importing.realigning import repair_drops
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.imported import import_one
from tests.unit.session.conftest import jpeg

PERIOD_NS = 100_000_000


def imported(root: Path, **frames: list[int]) -> Session:
    """A session of cameras whose images show these frames, and are named one after the other."""
    for camera, shown in frames.items():
        folder = root / "recording" / camera
        folder.mkdir(parents=True)
        for number, frame in enumerate(shown):
            (folder / f"{number}.jpg").write_bytes(jpeg(frame))
    return import_one([str(root / "recording")], root, "take", ImportOptions(fps=10))


def frames_at(session: Session, number: int) -> dict[str, int]:
    """The frame that each camera's image of an instant shows."""
    known = {jpeg(frame): frame for frame in range(12)}
    found = session.images_by_instant()[number]
    return {name: known[session.image_file(one).read_bytes()] for name, one in found.items()}


@pytest.mark.parametrize(
    ("shown", "steps"),
    [
        ([0, 1, 2, 4, 5, 6, 8, 9], [(3, 1), (6, 1)]),
        ([0, 1, 1, 2, 3, 4, 5, 6, 7, 8], [(2, -1)]),
        ([0, 1, 1, 2, 4, 5, 6, 7, 8, 9], [(2, -1), (4, 1)]),
    ],
)
def test_images_are_of_one_instant_again(
    tmp_path: Path, shown: list[int], steps: list[tuple[int, int]]
) -> None:
    session = imported(tmp_path, L=list(range(10)), R=shown)
    assert any(len(set(frames_at(session, k).values())) > 1 for k in range(8))
    repaired = repair_drops(session, {"R": steps})
    assert verify(repaired) == []
    assert repaired.manifest.burst.instants_ns == tuple(np.arange(10) * PERIOD_NS)
    for k in range(10):
        assert frames_at(repaired, k) == {"L": k} | ({"R": k} if k in shown else {})


def test_a_session_and_its_cameras_are_called_as_before(tmp_path: Path) -> None:
    for camera in ("Böhm", "カメラ"):
        (tmp_path / "r" / camera).mkdir(parents=True)
        for number, frame in enumerate((0, 1, 2, 4, 5, 6)):
            (tmp_path / "r" / camera / f"{number}.jpg").write_bytes(jpeg(frame))
    session = import_one([str(tmp_path / "r")], tmp_path, "歩く", ImportOptions(fps=10))
    repaired = repair_drops(session, {session.manifest.cameras[1].name: [(3, 1)]})
    assert repaired.manifest.label == "歩く"
    assert repaired.manifest.labels == session.manifest.labels


def test_a_captured_session_keeps_its_times(session: Session) -> None:
    with pytest.raises(NotApplicableError, match="was not imported"):
        repair_drops(session, {})
