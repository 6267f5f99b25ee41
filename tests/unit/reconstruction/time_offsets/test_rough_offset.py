"""Where recordings without common times overlap, by the amount of motion and by points that agree."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.time_offsets.crossings import OffsetFit
from reconstruction.time_offsets.rough_offset import (
    MAX_ERROR_FRAMES,
    Activity,
    find_rough_offset,
    repeats_after_ms,
    rough_offsets_ms,
)

PERIOD_MS = 40.0
LEVELS = np.random.default_rng(4).uniform(1, 6, 400)
PENDULUM_MS = 2800.0


def bursts(at_ms: Array) -> Array:
    """An amount of motion that never repeats."""
    return np.asarray(np.interp(at_ms, 90.0 * np.arange(-100, 300), LEVELS))


def pendulum(at_ms: Array) -> Array:
    """The same amount of motion every 2.8 s."""
    return bursts(at_ms % PENDULUM_MS)


def activity(late_ms: float = 0.0, images: int = 150, motion: Callable[[Array], Array] = bursts) -> Activity:
    """What a camera sees whose times are so much too early."""
    at_ms = PERIOD_MS * np.arange(images)
    return at_ms, motion(at_ms + late_ms)


class Points:
    """Moving points that agree on some offsets, and what they are asked for."""

    def __init__(self, votes: dict[float, float], examined: int = 10) -> None:
        self.votes, self.examined, self.asked = votes, examined, list[tuple[int, float, float | None]]()

    def __call__(
        self, limit: int, *, rough: tuple[float, float], beside_ms: float | None = None
    ) -> OffsetFit:
        near_ms, reach_ms = rough
        assert reach_ms == MAX_ERROR_FRAMES * PERIOD_MS
        self.asked.append((limit, near_ms, beside_ms))
        for at_ms, votes in self.votes.items():
            if abs(at_ms - near_ms) <= reach_ms:
                return OffsetFit(at_ms, 1.0, votes=votes, unvoted=tuple(range(self.examined)))
        return OffsetFit(reason=f"nothing agrees near {near_ms:.0f} ms")


@pytest.mark.parametrize("late_ms", [-1200.0, 0.0, 1640.0])
def test_the_amount_of_motion_tells_the_offset_best_and_few_others_apart(late_ms: float) -> None:
    offsets = rough_offsets_ms(activity(), activity(late_ms), PERIOD_MS)
    assert offsets[0] == pytest.approx(late_ms, abs=PERIOD_MS / 3)
    assert 1 < len(offsets) <= 8
    apart = np.diff(np.sort(offsets))
    assert apart.min() > 4 * PERIOD_MS / 3 - 1e-6


def test_recordings_that_begin_at_other_times_are_compared_by_their_times() -> None:
    at_ms, change = activity(800.0)
    assert rough_offsets_ms(activity(), (at_ms + 5000, change), PERIOD_MS)[0] == pytest.approx(
        800 - 5000, abs=PERIOD_MS / 3
    )


def test_few_images_tell_no_offset() -> None:
    assert len(rough_offsets_ms(activity(images=60), activity(images=30), PERIOD_MS)) > 0
    assert rough_offsets_ms(activity(images=60), activity(images=7), PERIOD_MS) == []
    slower = activity(images=40, motion=lambda ms: np.asarray(np.exp(-ms / 500)))
    faster = activity(images=40, motion=lambda ms: np.asarray(np.exp(ms / 500)))
    assert rough_offsets_ms(slower, faster, PERIOD_MS) == []
    # Over at least a second: ends that are alike for less are no match.
    late = activity(images=40)
    assert all(abs(ms) <= PERIOD_MS * 40 - 1e3 for ms in rough_offsets_ms(late, late, PERIOD_MS))


def test_a_motion_repeats_after_its_period_and_others_do_not() -> None:
    assert repeats_after_ms(activity(motion=pendulum), PERIOD_MS) == pytest.approx(
        PENDULUM_MS, abs=PERIOD_MS / 2
    )
    assert repeats_after_ms(activity(), PERIOD_MS) is None


@pytest.mark.parametrize("count", [60, 90, 120])
@pytest.mark.parametrize("frames", [11.3, 17.0, 23.7])
def test_a_motion_that_repeats_exactly_does_so_first_after_one_period(count: int, frames: float) -> None:
    """All of its minima are as deep, and noise makes the last one the deepest."""
    at = np.arange(count)
    for phase in range(8):
        noise = np.random.default_rng(phase).random(count)
        motion = 1 + 0.9 * np.sin(2 * np.pi * at / frames + phase) + 0.03 * noise
        repeats_ms = repeats_after_ms((at * PERIOD_MS, motion), PERIOD_MS)
        assert repeats_ms == pytest.approx(frames * PERIOD_MS, abs=PERIOD_MS / 2)


def find(measure: Points, first: Activity, second: Activity, repeats_ms: float = 0.0) -> Any:
    return find_rough_offset(measure, first, second, repeats_ms, PERIOD_MS)


def lone(candidates: Sequence[float]) -> float:
    """A candidate that is near no other."""
    reach_ms = 2 * MAX_ERROR_FRAMES * PERIOD_MS
    return next(
        ms for ms in candidates[1:] if all(abs(ms - other) > reach_ms for other in {*candidates} - {ms})
    )


def test_the_offset_on_which_most_points_agree_is_taken() -> None:
    """What the amount of motion allows is tried once each; the best is known to a period and a half."""
    second = activity(1640.0)
    candidates = rough_offsets_ms(activity(), second, PERIOD_MS)
    other = lone(candidates)
    points = Points({1642.0: 90.0, other: 50.0})
    assert find(points, activity(), second) == (1642.0, 1.5 * PERIOD_MS)
    assert points.asked == [(8, ms, None) for ms in candidates]
    # One that has nearly as many is compared at more instants, at first at those of both.
    points = Points({1642.0: 90.0, other: 70.0})
    assert find(points, activity(), second) == (1642.0, 1.5 * PERIOD_MS)
    assert points.asked[len(candidates) :] == [(24, 1642.0, other), (24, other, 1642.0)]


def test_offsets_on_which_as_many_points_agree_are_named() -> None:
    second = activity(1640.0)
    other = lone(rough_offsets_ms(activity(), second, PERIOD_MS))
    said = find(Points({1642.0: 90.0, other: 80.0}), activity(), second)
    low, high = sorted((1642.0, other))
    assert said == f"the motion repeats: offsets of {low:+.0f}, {high:+.0f} ms fit equally"
    # At few instants of both, each one's own count, and have to differ more.
    few = Points({1642.0: 90.0, other: 70.0}, examined=5)
    assert "fit equally" in find(few, activity(), second)
    assert few.asked[-2:] == [(24, 1642.0, None), (24, other, None)]
    enough = Points({1642.0: 90.0, other: 70.0}, examined=6)
    assert find(enough, activity(), second) == (1642.0, 1.5 * PERIOD_MS)


def test_a_motion_that_repeats_fits_at_each_of_its_periods() -> None:
    """By its own period, and by that of the amount of motion."""
    every = {1200.0 * n: 90.0 for n in range(-4, 5)}
    said = find(Points(every), activity(), activity(), 1200.0)
    assert said.startswith("the motion repeats: offsets of -2400, -1200, +0, +1200, +2400 ms fit equally, ")
    assert said.endswith("and others 1200 ms apart")
    swinging, swings = activity(motion=pendulum), {PENDULUM_MS * n: 90.0 for n in range(-4, 5)}
    said = find(Points(swings | {0.0: 91.0}), swinging, swinging)
    assert said == "the motion repeats: offsets of -5600, -2800, +0, +2800, +5600 ms fit equally"
    assert find(Points({0.0: 91.0}), swinging, swinging).startswith("the motion repeats: offsets of -5600")
    fewer = dict.fromkeys(swings, 50.0) | {0.0: 91.0}
    assert find(Points(fewer), swinging, swinging) == (0.0, 1.5 * PERIOD_MS)
    # Where recordings overlap for less than eight images, nothing can be compared.
    short = activity(images=60)
    assert "2400" not in find(Points(every), short, short, 1200.0)


def test_no_offset_has_the_last_ones_reason() -> None:
    assert find(Points({}), activity(), activity(images=5)) == (
        "the amount of motion in view matches at no offset"
    )
    candidates = rough_offsets_ms(activity(), activity(), PERIOD_MS)
    assert find(Points({}), activity(), activity()) == f"nothing agrees near {candidates[-1]:.0f} ms"
