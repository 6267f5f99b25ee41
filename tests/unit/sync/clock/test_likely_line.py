"""The line between upper and lower bounds, where the truth is known."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.sync.clock.likely_line import MAX_SKEW, SPELL_NS, LikelyLine, Point, fit_line, lower_hull

S = 1e9


def bounds(
    skew: float, offset: float, *, count: int, seconds: float, power: float, seed: int = 1
) -> tuple[list[Point], list[Point]]:
    """Bounds of exchanges over the last seconds; delays are 1 ms * u^(1/power), their minimum is 0.5 ms."""
    rng, uppers, lowers = random.Random(seed), [], []
    for i in range(count):
        t = -seconds * S * i / count
        there, back = (5e5 + 1e6 * rng.random() ** (1.0 / power) for _ in range(2))
        uppers.append((t, offset + skew * t + there))
        lowers.append((t, -offset - skew * t + back))
    return uppers, lowers


def fit(skew: float = 0.0, offset: float = 0.0, **drawn: float) -> LikelyLine:
    usual = {"count": 300, "seconds": 10.0, "power": 1.0, "seed": 1} | drawn
    count, seed = int(usual["count"]), int(usual["seed"])
    return line_between(
        *bounds(skew, offset, count=count, seconds=usual["seconds"], power=usual["power"], seed=seed)
    )


def line_between(uppers: list[Point], lowers: list[Point]) -> LikelyLine:
    return fit_line(uppers, lower_hull(uppers), lowers, lower_hull(lowers))


@pytest.mark.parametrize("skew_ppm", [-990.0, -150.0, -20.0, 0.0, 40.0, 300.0, 990.0])
def test_it_finds_any_skew_up_to_the_limit(skew_ppm: float) -> None:
    line = fit(skew_ppm * 1e-6, 7e6)
    assert line.skew * 1e6 == pytest.approx(skew_ppm, abs=4.0)
    assert line.offset == pytest.approx(7e6, abs=30e3)
    assert line.gap == pytest.approx(1e6, rel=0.05)


def test_the_prior_skew_is_assumed_while_the_bounds_show_none() -> None:
    line = fit(count=300, seconds=0.01)
    assert abs(line.skew) < 1e-6
    assert 20e-6 < line.skew_variance**0.5 < 60e-6


def test_the_variance_grows_outside_the_bounds() -> None:
    line = fit()
    assert line.variance_at(0.0) < line.variance_at(5 * S) < line.variance_at(50 * S)
    assert line.variance_at(0.0) >= line.excess > 0.0


def test_delays_that_rarely_come_near_their_minimum_leave_more_open() -> None:
    assert fit(power=3.0).excess > 4.0 * fit(power=1.0).excess


def test_equal_delays_of_one_spell_count_once() -> None:
    rng, uppers, lowers = random.Random(3), [], []
    for spell in range(50):
        there, back = (5e5 + 1e6 * rng.random() for _ in range(2))
        for i in range(10):
            t = -SPELL_NS * (spell + 0.05 + 0.1 * i)
            uppers.append((t, there))
            lowers.append((t, back))
    once = line_between(uppers[::10], lowers[::10])
    repeated = line_between(uppers, lowers)
    assert repeated.excess**0.5 == pytest.approx(once.excess**0.5, rel=0.2)
    assert repeated.excess**0.5 > 10_000.0, "all of the ten tightest are of one spell"


@pytest.mark.parametrize("directions", [1, 2])
def test_rare_faster_messages_shift_the_offset_only_if_both_directions_have_them(directions: int) -> None:
    uppers, lowers = bounds(0.0, 0.0, count=600, seconds=2.0, power=2.0)
    for bounds_of_one in (uppers, lowers)[:directions]:
        bounds_of_one += [(-0.2 * S, 1e5), (-0.1 * S, 1.1e5)]
    line = line_between(uppers, lowers)
    assert abs(line.offset) < 30e3, "half of the 400 us by which one direction is faster"
    assert abs(line.skew) < 40e-6
    assert line.excess**0.5 > 100e3, "the error bar still covers a faster path in one direction only"


def test_a_moment_of_many_faster_messages_leaves_the_skew_to_all_others() -> None:
    uppers, lowers = bounds(40e-6, 0.0, count=600, seconds=4.0, power=2.0)
    rng = random.Random(2)
    for i in range(16):
        t = -2.0 * S - 1e7 * i
        uppers.append((t, 40e-6 * t + 1e5 + rng.random() * 1e5))
        lowers.append((t, -40e-6 * t + 1e5 + rng.random() * 1e5))
    line = line_between(uppers, lowers)
    assert line.skew * 1e6 == pytest.approx(40.0, abs=8.0)
    assert line.skew_variance**0.5 < 20e-6


def test_a_path_that_has_become_faster_is_believed_after_seven_messages() -> None:
    uppers, lowers = bounds(0.0, 0.0, count=600, seconds=2.0, power=2.0)
    faster = line_between(uppers + [(-1e7 * n, 1e5 + 1e3 * n) for n in range(7)], lowers)
    assert faster.offset == pytest.approx(-2e5, abs=30e3)


def test_fast_messages_that_contradict_all_others_still_give_a_line() -> None:
    """Both kinds are exact to the nanosecond, at skews that are thousands of their widths apart."""
    dense = [(-i * S / 30, 1e6) for i in range(300)]
    fast = [-i * S * 10 / 12 for i in range(12)]
    line = line_between(
        dense + [(t, 2e5 + 30e-6 * t) for t in fast], dense + [(t, 2e5 - 30e-6 * t) for t in fast]
    )
    assert -1e-6 < line.skew < 31e-6
    assert abs(line.offset) < 1e6


def test_one_bound_of_each_direction_gives_the_middle_and_is_not_trusted() -> None:
    line = line_between([(0.0, 900.0)], [(0.0, -100.0)])
    assert (line.offset, line.gap) == pytest.approx((500.0, 800.0))
    assert line.excess**0.5 > 0.4 * 800.0


points = st.lists(st.tuples(st.integers(-(10**10), 0), st.integers(-(10**7), 10**7)), min_size=1, max_size=40)


@given(points, st.floats(-MAX_SKEW, MAX_SKEW))
def test_the_hull_keeps_the_tightest_bound_at_every_skew(given_points: list[Point], skew: float) -> None:
    hull = lower_hull(given_points)
    assert set(hull) <= set(given_points)
    tightest = min(v - skew * t for t, v in given_points)
    assert min(v - skew * t for t, v in hull) == pytest.approx(tightest, abs=1e-3)


@given(points, points)
def test_any_bounds_give_a_line(uppers: list[Point], lowers: list[Point]) -> None:
    line = line_between(uppers, lowers)
    assert abs(line.skew) <= MAX_SKEW
    assert line.variance_at(0.0) >= 0.0
