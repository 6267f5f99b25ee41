"""Times, counts and progress lines as people and programs read them."""

import unicodedata
from collections.abc import Callable

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.common.text import (
    ProgressStep,
    clock_offset,
    count,
    duration,
    printable,
    printable_json,
    terminal_json,
)


@pytest.mark.parametrize(
    ("text_of", "ns", "text"),
    [
        (duration, None, "–"),
        (duration, 0, "0 ns"),
        (duration, 850, "850 ns"),
        (duration, 1_234, "1.2 µs"),
        (duration, 12_400, "12 µs"),
        (duration, 999_499, "999 µs"),
        (duration, 999_600, "1.0 ms"),
        (duration, -3_400_000, "-3.4 ms"),
        (duration, 2_100_000_000, "2.1 s"),
        (clock_offset, None, "–"),
        (clock_offset, 45_000, "+45 µs"),
        (clock_offset, -12_300_000_000, "-12.3 s"),
        (clock_offset, 15_131_204_000_000, "+4 h 12 min"),
        (clock_offset, -3_599_000_000_000, "-1 h 00 min"),
        (clock_offset, 200 * 3_600_000_000_000, "+8 d 8 h"),
    ],
)
def test_times_are_short(text_of: Callable[[int | None], str], ns: int | None, text: str) -> None:
    assert text_of(ns) == text


def test_one_frame_is_no_frames() -> None:
    assert [count(number, "frame") for number in (0, 1, 2)] == ["0 frames", "1 frame", "2 frames"]


def test_a_progress_line_is_read_as_it_was_written() -> None:
    step = ProgressStep(3, 12, "stereo cam00-cam01, instant 4")
    assert str(step) == "[3/12] stereo cam00-cam01, instant 4"
    assert ProgressStep.parse(str(step)) == step
    assert ProgressStep.parse("cam00 joined") is None


ORDERING = "\u061c\u200e\u200f\u2028\u2029\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\ufeff"
TEXTS = st.text(st.one_of(st.characters(codec="utf-8"), st.sampled_from(ORDERING)), max_size=20)


def test_control_characters_are_shown_not_obeyed() -> None:
    assert printable("a\x1b[31m\rb\tc\n") == "a\\x1b[31m\\rb\tc\n"
    assert printable("gpj\u202e.exe \u2066x\u2069\u2028y") == "gpj\\u202e.exe \\u2066x\\u2069\\u2028y"
    assert printable("caf\udce9.jpg") == "caf\\udce9.jpg", "a file's name in Latin 1"
    assert printable("日本 👩\u200d🚀 עברית") == "日本 👩\u200d🚀 עברית"


@settings(max_examples=50)
@given(st.dictionaries(TEXTS, TEXTS, max_size=5))
def test_json_is_printable_and_keeps_all_but_control_characters(value: dict[str, str]) -> None:
    data = msgspec.json.encode(value)
    expected = {"".join(map(shown, key)): "".join(map(shown, text)) for key, text in value.items()}
    assert msgspec.json.decode(printable_json(data)) == expected
    printed = terminal_json(value)
    assert msgspec.json.decode(printed) == value
    assert not any(is_control(letter) for letter in printed.decode())


def is_control(letter: str) -> bool:
    return unicodedata.category(letter) == "Cc" or letter in ORDERING


def shown(letter: str) -> str:
    return "\ufffd" if letter not in "\n\t" and is_control(letter) else letter


@given(st.binary())
def test_what_is_no_json_is_no_error(data: bytes) -> None:
    printable_json(data)
    for cut in (rb'"\u', rb'"\u00', rb'"\u00g1"', rb'"\x1b"', b'"\\'):
        printable_json(cut + data)
        assert printable_json(cut) == cut


def test_a_backslash_before_an_escape_is_not_mistaken_for_one() -> None:
    text = r"C:\u001b \\u009b"
    data = msgspec.json.encode(text)
    assert printable_json(data) == data
