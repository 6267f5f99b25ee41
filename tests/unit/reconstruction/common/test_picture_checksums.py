"""Pictures whose bytes are not those that were saved."""

import shutil
from pathlib import Path

import cv2
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.reading.reader import Session
from reconstruction.common.picture_checksums import REQUIRED
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import Reconstruct


@pytest.fixture
def changed(boards: Session, tmp_path: Path) -> tuple[Path, Path]:
    """A session, and the picture in it that has been exchanged for another of as many bytes."""
    folder = shutil.copytree(boards.folder, tmp_path / "session")
    picture = folder / boards.image_file(boards.images_by_instant()[0]["left"]).relative_to(boards.folder)
    # Smoother, so that it is smaller.
    pixels = cv2.GaussianBlur(cv2.imread(str(picture)), (5, 5), 0)
    encoded = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
    picture.write_bytes(encoded.ljust(picture.stat().st_size, b"\0"))
    return folder, picture


def test_changed_pictures_are_named(
    changed: tuple[Path, Path], tmp_path: Path, reconstruct: Reconstruct
) -> None:
    folder, picture = changed
    done = reconstruct("stereo", folder, "--pair", "left,right", "--out", tmp_path / "out", "--json")
    assert done.result["changed_pictures"] == [str(picture)]
    assert f"{picture}: not the bytes that were saved" in done.err


def test_they_are_refused_where_checksums_are_required(
    changed: tuple[Path, Path], tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(REQUIRED, "1")
    folder, picture = changed
    out = tmp_path / "out"
    done = reconstruct("stereo", folder, "--pair", "left,right", "--out", out)
    assert done.code == 7
    assert f"{picture} is damaged" in done.err
    assert not out.exists()


def test_pictures_as_they_were_saved_are_not_mentioned(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    done = reconstruct("stereo", boards.folder, "--pair", "left,right", "--out", tmp_path / "out", "--json")
    assert done.result["changed_pictures"] == []
    assert "saved" not in done.err


def test_a_picture_that_is_gone_by_then_is_named(changed: tuple[Path, Path]) -> None:
    folder, picture = changed
    dataset = Dataset.open(folder)
    picture.unlink()
    with pytest.raises(BadInputError, match=f"cannot read {picture}"):
        dataset.image("left", 0)
