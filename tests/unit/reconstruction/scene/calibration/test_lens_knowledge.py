"""How well a calibration knows its focal lengths: from errors, and from files of earlier versions."""

import msgspec
import pytest

from capture_app.session.format.calibration import Calibration, LensKnowledge
from reconstruction.scene.calibration.consistency import lens_knowledge, no_measurement


def test_only_lenses_with_an_error_are_confirmed() -> None:
    unknown = lens_knowledge([], "too few points")
    assert unknown.doubt() == unknown.text == "focal lengths not known well enough: too few points"
    assert unknown.is_doubtful
    known = lens_knowledge([0.01, 0.02])
    assert known.text == "focal lengths off by up to 1 to 2 % (95 %)"
    assert not known.doubt(rough=True)
    assert not known.is_doubtful
    assert not no_measurement(known)
    roughly = lens_knowledge([0.028, 0.032])
    assert not roughly.doubt()
    doubt = roughly.doubt(rough=True)
    assert doubt == "focal lengths known roughly: off by up to 2.8 to 3.2 % (95 %)"
    assert f"this depth is inaccurate: {doubt}" in no_measurement(roughly)
    assert lens_knowledge([0.05, 0.12]).doubt().endswith("enough: off by up to 5 to 12 % (95 %)")
    assert lens_knowledge([0.01, 0.02], is_guess=True).is_doubtful


@pytest.mark.parametrize(
    ("source", "level", "why", "is_guess"),
    [
        ("Caliscope", "well", "", False),
        ("ChArUco board, focal lengths off by up to 3 to 4 % (95 %)", "well", "", False),
        (
            "COLMAP, focal lengths known roughly: off by up to 3 %; not placed: d",
            "roughly",
            "off by up to 3 %",
            False,
        ),
        (
            "COLMAP, a guess from these pictures alone, focal lengths not known well enough: too few points",
            "not",
            "too few points",
            True,
        ),
    ],
)
def test_a_file_of_an_earlier_version_says_it_in_its_source(
    source: str, level: str, why: str, is_guess: bool
) -> None:
    found = msgspec.json.decode(
        msgspec.json.encode({"cameras": {}, "source": source}), type=Calibration
    ).known_lenses
    assert (found.level, found.is_guess) == (level, is_guess)
    assert found.why.startswith(why)


def test_the_field_is_believed_before_words_that_others_wrote() -> None:
    known = LensKnowledge(why="off by up to 1 % (95 %)")
    source = "COLMAP, focal lengths not known well enough: too few points"
    assert Calibration(cameras={}, source=source, lenses=known).known_lenses == known
