"""Ground truth that was cut or changed is refused by name, whatever its reader raises."""

import shutil
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.reading.reader import Session
from reconstruction.scene.dataset import Dataset


@pytest.mark.parametrize("keep", [0.0, 0.1, 0.5, 0.99])
def test_a_cut_file_of_ground_truth_is_no_error_of_python(
    boards: Session, tmp_path: Path, keep: float
) -> None:
    folder = tmp_path / "boards"
    shutil.copytree(boards.folder, folder)
    dataset = Dataset.open(folder)
    path = dataset.ground_truth_file("left", 0)
    assert path is not None
    data = path.read_bytes()
    path.write_bytes(data[: round(keep * len(data))])
    with pytest.raises(BadInputError, match=r"cannot read .*000000\.npz as arrays"):
        dataset.ground_truth("left", 0)
    middle = len(data) // 2
    path.write_bytes(data[:middle] + bytes(64) + data[middle + 64 :])
    with pytest.raises(BadInputError, match=r"cannot read .*000000\.npz as arrays"):
        dataset.ground_truth("left", 0)
