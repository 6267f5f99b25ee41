"""Frames get the number and time that their page's words allow."""

import random

import pytest

from capture_app.companions.phones.phone import HELD_FRAMES, FrameTimes, PhoneFrame
from capture_app.companions.phones.wire import FrameReport

PERIOD_US = 33_333.3


def told(
    count: int, *, stream: int = 1, first: int = 0, gaps: tuple[int, ...] = (), rng: random.Random
) -> list[FrameReport]:
    """Frames at an even pace whose arrivals are late by 8 ms at least, and by more at random."""
    return [
        FrameReport(
            n, stream, n * PERIOD_US, 500_000 + n * PERIOD_US + 8_000 + rng.expovariate(1 / 3_000), None
        )
        for n in range(first, first + count)
        if n not in gaps
    ]


def timed(times: FrameTimes, frames: list[FrameReport]) -> list[PhoneFrame]:
    return [one for frame in frames for one in times.add(frame)]


def test_times_are_even_however_late_frames_come() -> None:
    times = FrameTimes(30.0)
    frames = timed(times, told(300, rng=random.Random(1)))
    assert times.period_ns == 33_333_333
    assert [frame.sequence for frame in frames] == list(range(300))
    late = [frame.page_us - 500_000 - frame.id * PERIOD_US for frame in frames[-50:]]
    assert max(late) - min(late) < 1.0
    assert 8_000 <= late[0] < 8_500


def test_a_gap_is_counted() -> None:
    frames = timed(FrameTimes(30.0), told(60, gaps=(40, 41), rng=random.Random(2)))
    assert [frame.sequence for frame in frames] == [n for n in range(60) if n not in (40, 41)]


@pytest.mark.parametrize(
    ("says", "keeps_us", "period_ns"),
    [(30.0, 33_367.0, 33_333_333), (30.0, 66_700.0, 66_666_667), (0.0, 40_000.0, 40_000_000)],
)
def test_the_rate_is_what_the_browser_says_where_it_keeps_it(
    says: float, keeps_us: float, period_ns: int
) -> None:
    times = FrameTimes(says)
    timed(times, [FrameReport(n, 1, n * keeps_us, n * keeps_us, None) for n in range(40)])
    assert times.period_ns == period_ns


def test_a_restarted_stream_begins_anew_and_waits_for_its_least_delay() -> None:
    times, rng = FrameTimes(30.0), random.Random(3)
    timed(times, told(60, rng=rng))
    again = told(HELD_FRAMES + 2, stream=2, first=100, rng=rng)
    assert timed(times, again[: HELD_FRAMES - 1]) == []
    frames = timed(times, again[HELD_FRAMES - 1 :])
    assert [(frame.stream, frame.sequence) for frame in frames] == [(2, n) for n in range(HELD_FRAMES + 2)]


def test_the_capture_time_that_a_browser_tells_goes_before_the_arrival() -> None:
    frames = [
        FrameReport(n, 1, n * PERIOD_US, n * PERIOD_US + 90_000, n * PERIOD_US + 20_000) for n in range(40)
    ]
    assert timed(FrameTimes(30.0), frames)[0].page_us == pytest.approx(20_000)


@pytest.mark.parametrize(("rate", "step_us"), [(0.0, 1e-6), (30.0, 5e-324), (1e-305, 0.0), (0.0, 1e15)])
def test_a_rate_that_no_camera_has_is_not_believed(rate: float, step_us: float) -> None:
    times = FrameTimes(rate)
    for n in range(40):
        times.add(FrameReport(n, 1, n * step_us, 500_000 + n * PERIOD_US, None))
    assert times.period_ns is not None
    assert 1_000_000 <= times.period_ns <= 1_000_000_000
