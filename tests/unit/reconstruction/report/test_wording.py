"""Numbers and times in the words of a report."""

import pytest

from capture_app.common.text import count
from reconstruction.common import wording


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "n/a"),
        (float("nan"), "n/a"),
        (0.0, "0 %"),
        (0.0004, "under 0.1 %"),
        (0.004, "0.4 %"),
        (0.0112, "1 %"),
        (0.981, "98 %"),
        (0.9999, "99.9 %"),
        (1.0, "100 %"),
    ],
)
def test_shares_never_round_up_to_all_or_down_to_nothing(value: float | None, words: str) -> None:
    assert wording.percentage(value, decimals=0).replace(wording.GAP, " ") == words


@pytest.mark.parametrize(
    ("shown", "words"),
    [
        (wording.milliseconds(66.0), "66 ms"),
        (wording.milliseconds(66.64), "66.6 ms"),
        (wording.offset_text(-33.3), "33 ms early"),
        (wording.offset_text(0.54), "0.5 ms late"),
        (wording.microseconds(None), "n/a"),
        (wording.microseconds(999.4), "999 µs"),
        (wording.microseconds(1912), "1.9 ms"),
        (wording.quantity(9.996), "10.0"),
        (wording.quantity(0.256, "px"), "0.26 px"),
        (wording.quantity(170.4), "170"),
        (wording.quantity(85561.2), "85 561"),
        (wording.seconds(119.96), "120.0 s"),
        (
            " | ".join(wording.headline("It is 98.1 % right. At 66 ms not. So.")[1]),
            "At 66 ms not. | So.",
        ),
        (wording.seconds(185), "3 min 5 s"),
        (count(1, "frame"), "1 frame"),
    ],
)
def test_numbers_read_well(shown: str, words: str) -> None:
    assert shown.replace(wording.GAP, " ") == words


def test_numbers_stay_with_their_units() -> None:
    assert wording.keep_units("2 % in 3 ms, 4 miles") == f"2{wording.GAP}% in 3{wording.GAP}ms, 4 miles"
