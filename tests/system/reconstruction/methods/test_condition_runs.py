"""Methods under a condition: stereo shows the second camera late, a panorama has both side by side."""

from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.reading.reader import Session
from reconstruction import Condition, Panorama, Stereo
from reconstruction.scene.dataset import Dataset
from tests.project import JUMPER


def test_stereo_under_a_condition_takes_another_instant(boards: Session, tmp_path: Path) -> None:
    times_ns = Dataset.open(boards.folder).instants_ns
    late = Condition.parse(f"right={(times_ns[3] - times_ns[1]) / 1e6}")
    made = Stereo(instant=1, pair=("left", "right")).make([boards.folder], tmp_path / "late", late)
    assert (made.instant, made.other_instant) == (1, 3)
    assert made.within_2pct < 0.98


def test_a_panorama_under_a_condition_is_stitched_in_both(tmp_path: Path) -> None:
    late = Condition.parse("66")
    one = Panorama(instant=1).make([JUMPER], tmp_path / "one", late)
    assert one.offset is not None
    assert one.actual_offset_ms == pytest.approx(66, abs=1)
    with pytest.raises(BadInputError, match="--condition needs a session"):
        Panorama().make([JUMPER / "images"], tmp_path / "images", late)
