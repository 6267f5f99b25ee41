"""The row time, found in frame durations that are whole rows told in whole microseconds."""

import random
from math import floor

import pytest

from capture_app.plugins.cameras.libcamera.configuration import typical_period_ns
from capture_app.plugins.cameras.libcamera.libcamera_driver import durations_to_ask_us, find_row_time_us


def told_us(row_us: float, asked_us: list[int], *, cut: bool = True) -> list[int]:
    exact = [floor(asked / row_us) * row_us for asked in asked_us]
    return [floor(one) if cut else round(one) for one in exact]


@pytest.mark.parametrize("cut", [True, False])
@pytest.mark.parametrize("fps", [10, 30, 60])
def test_rows_of_6_to_200_us_are_found_to_a_tenth_of_a_row_in_a_frame(fps: int, cut: bool) -> None:
    period_us, rng = round(1e6 / fps), random.Random(fps)
    for _ in range(12):
        row_us = 6.0 * (200 / 6.0) ** rng.random()
        found = find_row_time_us(told_us(row_us, durations_to_ask_us(period_us, 4 * period_us), cut=cut))
        assert found is not None
        assert abs(found - row_us) * period_us / row_us < 0.1 * row_us


def test_durations_that_are_no_whole_rows_tell_none() -> None:
    measured = [
        us + random.Random(us).randint(-3, 3) for us in told_us(18.9, durations_to_ask_us(33_333, 60_000))
    ]
    assert find_row_time_us(measured) is None


@pytest.mark.parametrize("told", [[], [33_333] * 50, [0, *range(30_000, 30_020)]])
def test_too_few_or_impossible_durations_tell_none(told: list[int]) -> None:
    assert find_row_time_us(told) is None


def test_asked_for_are_durations_that_the_camera_has() -> None:
    assert max(durations_to_ask_us(33_333, 35_000)) <= 35_000
    assert min(durations_to_ask_us(33_333, 35_000)) >= 33_333


@pytest.mark.parametrize(
    ("measured_ns", "meant_ns"),
    [(33_334_400, 33_333_333), (33_366_000, 33_366_667), (66_666_000, 66_666_667), (33_712_345, 33_710_000)],
)
def test_a_measured_period_is_taken_for_a_usual_one_near_it(measured_ns: int, meant_ns: int) -> None:
    assert typical_period_ns(measured_ns) == meant_ns
