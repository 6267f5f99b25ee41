"""The folder of a result: on a full disk one clear line, and nothing left."""

import errno
from pathlib import Path

import pytest

from capture_app.errors import SimulshotError
from reconstruction.common import output_folder as output
from reconstruction.common.output_folder import Output
from reconstruction.multiview.output import whole_folder


@pytest.mark.parametrize("folder", [Output, lambda target: whole_folder(target, ())])
def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: Path, folder: type[Output]) -> None:
    with (
        pytest.raises(SimulshotError, match=r"no space is left on the disk for .*out"),
        folder(tmp_path / "out"),
    ):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert not list(tmp_path.iterdir())


def test_a_writer_that_gives_no_reason_is_asked_how_much_room_there_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(OSError, match="cannot write"), Output(tmp_path / "out"):
        raise OSError("cannot write picture.jpg")
    monkeypatch.setattr(output, "LITTLE_BYTES", 1 << 60)
    with pytest.raises(SimulshotError, match="no space is left"), Output(tmp_path / "out"):
        raise OSError("cannot write picture.jpg")
    assert not list(tmp_path.iterdir())
