"""Every command of `reconstruct` writes its folder whole, and says plainly when the disk is full."""

from pathlib import Path

import pytest

from capture_app.common.errors import ExitCode
from capture_app.session.files.disk import is_full
from capture_app.session.reading.reader import Session
from reconstruction.common.outputs import comparison_folder
from tests.unit.reconstruction.conftest import Reconstruct


@pytest.mark.parametrize("command", ["compare", "tolerance", "stereo", "panorama", "multiview"])
def test_a_second_run_to_one_folder_is_refused(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct, command: str
) -> None:
    out = tmp_path / "out"
    with comparison_folder(out):
        refused = reconstruct(command, boards.folder, "--out", out)
    assert refused.code == ExitCode.BAD_INPUT
    assert f"another run is writing to {out}" in refused.complaint


def test_a_writer_that_gives_no_reason_is_asked_how_much_room_there_was(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="cannot write"), comparison_folder(tmp_path / "out"):
        raise OSError("cannot write picture.jpg")
    assert not list(tmp_path.iterdir())
    unexplained = OSError("cannot write picture.jpg")
    assert not is_full(unexplained, tmp_path)
    assert is_full(unexplained, tmp_path, little_bytes=1 << 60)
