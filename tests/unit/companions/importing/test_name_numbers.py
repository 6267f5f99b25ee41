"""Which number in the names of images counts the frames, and what is paired by it."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.times.rules import frame_numbers
from capture_app.session.importing.recording_sources import numbers_in
from tests.imported import import_one

NAMES: dict[str, Callable[[int], str]] = {
    "a number": "frame_{:04d}".format,
    "with a size": "frame_{:04d}_160x120".format,
    "of a copy": "IMG_{:04d} (1)".format,
    "hours, minutes, seconds, frames": lambda i: f"00-01-{58 + i // 5:02d}-{i % 5:02d}",
    "a date and a counter": lambda i: f"20260131_{142530 + i // 4}_{i % 4}",
    "a rate": "{:d}_30fps".format,
    "a take and a codec": "take2_{:03d}_h264".format,
}


@pytest.mark.parametrize("named", NAMES.values(), ids=NAMES)
def test_a_missing_number_is_a_missing_frame(
    named: Callable[[int], str], tmp_path: Path, make_images: Callable[..., Path]
) -> None:
    folder = make_images("a", [f"{named(i)}.png" for i in range(12)]).parent
    make_images("b", [f"{named(i)}.png" for i in range(12) if i != 4])
    session = import_one([str(folder)], tmp_path, "s", ImportOptions(fps=30))
    assert [(gone.camera, gone.instant) for gone in session.manifest.missing] == [("b", 4)]
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.reason == "frames of equal number are taken as of one instant"


def test_names_without_a_common_number_are_paired_by_place_and_this_is_said(
    tmp_path: Path, make_images: Callable[..., Path]
) -> None:
    folder = make_images("a", ["one.png", "two.png"]).parent
    make_images("b", ["five.png", "six.png"])
    session = import_one([str(folder)], tmp_path, "s", ImportOptions(fps=30))
    times = session.manifest.burst.common_times
    assert times is not None
    assert "paired by their place" in times.reason
    assert len(session.manifest.images) == 4


@pytest.mark.parametrize(
    ("cameras", "numbers"),
    [
        ({"a": ["1_77", "2_79"], "b": ["1_78", "2_80"]}, {"a": [1, 2], "b": [1, 2]}),
        ({"a": ["c1_5", "c1_6"], "b": ["c2_6", "c2_7"]}, {"a": [5, 6], "b": [6, 7]}),
        ({"a": ["5", "6"], "b": ["take2_6", "take2_7"]}, {"a": [5, 6], "b": [6, 7]}),
        ({"a": ["1", "01"], "b": ["1", "2"]}, None),
        ({"a": ["1", "2"], "b": ["1", "2_3"]}, None),
        ({"a": ["1_5", "2_6"], "b": ["3_7", "4_8"]}, {"a": [0, 1], "b": [2, 3]}),
        ({"a": ["1", "2"], "b": ["3", "4"]}, {"a": [1, 2], "b": [3, 4]}),
        # A number that changes for one camera counts for all whose names are alike.
        ({"a": ["1_58", "1_59"], "b": ["1_59", "2_0"]}, {"a": [0, 1], "b": [1, 2]}),
        # Two numbers may each be the one that counts.
        ({"a": ["5", "6"], "b": ["1_5", "2_6"]}, None),
        ({"a": ["1_5", "2_6"], "b": ["1_6", "2_5"]}, None),
        # The number of a single image may be its camera's.
        ({"a": ["1"], "b": ["2"]}, None),
        ({"a": ["1_5", "2_9"]}, {"a": [0, 1]}),
        ({"a": ["1_5", "2_6"], "b": ["2_6", "3_8"]}, {"a": [0, 1], "b": [1, 2]}),
    ],
)
def test_the_number_that_counts(cameras: dict[str, list[str]], numbers: dict[str, list[int]] | None) -> None:
    given_numbers = {camera: [numbers_in(name) for name in names] for camera, names in cameras.items()}
    assert frame_numbers(given_numbers) == numbers


@given(
    st.lists(st.lists(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, max_size=6), min_size=1, max_size=3)
)
def test_equal_numbers_are_equal_names(cameras: list[list[tuple[int, ...]]]) -> None:
    names = {str(number): of for number, of in enumerate(cameras)}
    found = frame_numbers(names)
    for camera, numbers in (found or {}).items():
        assert len(set(numbers)) == len(numbers) == len(names[camera])
