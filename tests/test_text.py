"""Times, counts and progress lines as people and programs read them."""

import pytest

from capture_app.text import ProgressStep, clock_offset, count, duration, printable


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (None, "–"),
        (0, "0 ns"),
        (850, "850 ns"),
        (1_234, "1.2 µs"),
        (12_400, "12 µs"),
        (999_499, "999 µs"),
        (999_600, "1.0 ms"),
        (-3_400_000, "-3.4 ms"),
        (2_100_000_000, "2.1 s"),
    ],
)
def test_short_times(ns: int | None, text: str) -> None:
    assert duration(ns) == text


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (None, "–"),
        (45_000, "+45 µs"),
        (-12_300_000_000, "-12.3 s"),
        (15_131_204_000_000, "+4 h 12 min"),
        (-3_599_000_000_000, "-1 h 00 min"),
        (200 * 3_600_000_000_000, "+8 d 8 h"),
    ],
)
def test_offsets_of_clocks(ns: int | None, text: str) -> None:
    assert clock_offset(ns) == text


def test_one_frame_is_no_frames() -> None:
    assert [count(number, "frame") for number in (0, 1, 2)] == ["0 frames", "1 frame", "2 frames"]


def test_a_progress_line_is_read_as_it_was_written() -> None:
    step = ProgressStep(3, 12, "stereo cam00-cam01, instant 4")
    assert str(step) == "[3/12] stereo cam00-cam01, instant 4"
    assert ProgressStep.parse(str(step)) == step
    assert ProgressStep.parse("cam00 joined") is None


def test_control_characters_are_shown_not_obeyed() -> None:
    assert printable("a\x1b[31m\rb\tc\n") == "a\\x1b[31m\\rb\tc\n"
