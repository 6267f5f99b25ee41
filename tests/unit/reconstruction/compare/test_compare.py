"""`reconstruct compare` from a session on disk to its folder of results."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from capture_app.session.reading.reader import Session
from tests.unit.reconstruction.conftest import Reconstruct


@pytest.mark.parametrize(
    ("asked", "code", "words"),
    [
        (("--offset-ms", "900"), 3, "largest offset possible is 133 ms"),
        (("--stereo-pair", "left,nobody"), 3, "names nobody, which the recording lacks"),
        (("--stereo-pair", "left,left"), 3, "paired with itself"),
        (("--stereo-pair", "left"), 2, "two cameras with a comma"),
        (("--offset-ms", "soon"), 2, "soon"),
        (("--offset-ms", "nan"), 2, "nan"),
        (("--nonsense",), 2, "nonsense"),
    ],
)
def test_wrong_options_are_one_line(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct, asked: tuple[str, ...], code: int, words: str
) -> None:
    done = reconstruct("compare", boards.folder, "--out", tmp_path / "out", *asked)
    assert done.code == code
    assert words in done.complaint
    assert done.err.splitlines() == [done.complaint]
    assert done.out == ""
    assert list(tmp_path.iterdir()) == []


def cut(folder: Path) -> None:
    image = next(folder.glob("images/rig1/left/*.png"))
    image.write_bytes(image.read_bytes()[:100])


def overwrite(folder: Path, pattern: str, data: bytes) -> None:
    """Other bytes, as many as before where `data` is one byte."""
    for path in folder.glob(pattern):
        path.write_bytes(data * (path.stat().st_size if len(data) == 1 else 1))


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        (shutil.rmtree, 3),
        (lambda folder: (folder / "session.json").write_text("{"), 3),
        (lambda folder: next(folder.glob("images/rig1/left/*.png")).unlink(), 7),
        (cut, 7),
        (lambda folder: overwrite(folder, "images/rig1/left/*.png", b"x"), 3),
        (lambda folder: (folder / "calibration.json").write_text("[]"), 3),
    ],
)
def test_damaged_sessions_are_one_line_and_leave_nothing(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct, damage: Callable[[Path], object], code: int
) -> None:
    session = shutil.copytree(boards.folder, tmp_path / "session")
    damage(session)
    left = sorted(tmp_path.iterdir())
    done = reconstruct("compare", session, "--max-instants", 1, "--out", tmp_path / "out")
    assert done.code == code, done.err
    assert str(session) in done.complaint
    assert sorted(tmp_path.iterdir()) == left


def test_somebody_elses_folder_is_not_touched(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    done = reconstruct("compare", boards.folder, "--out", tmp_path)
    assert done.code == 3
    assert "thesis.tex" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
