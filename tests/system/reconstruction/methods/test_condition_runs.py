"""Methods under a condition: stereo shows the second camera late, a panorama has both side by side."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.common.errors import BadInputError
from capture_app.session.reading.reader import Session
from reconstruction import Condition, Panorama, Stereo
from reconstruction.scene.dataset import Dataset
from tests.project import JUMPER


def test_stereo_under_a_condition_is_that_of_another_instant(boards: Session, tmp_path: Path) -> None:
    times_ns = Dataset.open(boards.folder).instants_ns
    late = Condition.parse(f"right={(times_ns[3] - times_ns[1]) / 1e6}")
    pair = ("left", "right")
    made = [
        options.make([boards.folder], tmp_path / str(number), condition)
        for number, (options, condition) in enumerate(
            [
                (Stereo(instant=1, pair=pair), late),
                (Stereo(instant=1, pair=pair, other_instant=3), Condition("synced")),
            ]
        )
    ]
    assert (made[0].instant, made[0].other_instant) == (1, 3)
    assert replace(made[0], seconds=0.0) == replace(made[1], seconds=0.0)


def test_a_panorama_under_a_condition_is_that_with_an_offset(tmp_path: Path) -> None:
    late, plain = Condition.parse("66"), Panorama(instant=1)
    one = plain.make([JUMPER], tmp_path / "one", late)
    other = replace(plain, offset_ms=66.0).make([JUMPER], tmp_path / "other")
    assert one.offset is not None
    assert replace(one, seconds=0.0) == replace(other, seconds=0.0)
    with pytest.raises(BadInputError, match="--offset-ms is a condition of its own"):
        replace(plain, offset_ms=66.0).make([JUMPER], tmp_path / "both", late)
    with pytest.raises(BadInputError, match="--condition needs a session"):
        Panorama().make([JUMPER / "images"], tmp_path / "images", late)
