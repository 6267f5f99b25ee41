"""What a frame's stamp says about its rows, wherever in the frame the driver stamps."""

import pytest

from capture_app.camera_facts import CameraFacts, TimestampSource
from tests.facts import make_facts

MS = 1_000_000
START, END, UNKNOWN = TimestampSource


def facts(source: TimestampSource, row_time_ns: int | None = 10_000) -> CameraFacts:
    return make_facts(height=101, timestamp_source=source, row_time_ns=row_time_ns, exposure_ns=4 * MS)


def test_a_row_is_exposed_from_its_start_on_or_until_it_is_read() -> None:
    """The last of 101 rows starts 1 ms after the first; a stamp at the end of the frame is its end."""
    assert [facts(START).mid_exposure_offset_ns(row) for row in (0.0, 0.5, 1.0)] == [2 * MS, 2.5 * MS, 3 * MS]
    assert [facts(END).mid_exposure_offset_ns(row) for row in (0.0, 0.5, 1.0)] == [
        -3 * MS,
        -2.5 * MS,
        -2 * MS,
    ]


@pytest.mark.parametrize("unknown", [facts(UNKNOWN), facts(START, None), facts(END, None)])
def test_what_is_not_known_is_not_guessed(unknown: CameraFacts) -> None:
    assert unknown.mid_exposure_offset_ns(0.5) is None
