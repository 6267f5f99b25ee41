"""When a clock is known well enough, and when asking on in quick succession is over."""

from dataclasses import replace

from capture_app.sync.clock.likely_line import ASYMMETRY
from capture_app.sync.clock.time_map import SIGMAS_95, TimeMap
from capture_app.sync.timekeeping.poll_schedule import (
    AHEAD_NS,
    LEAVE_AT,
    LINK_MARGIN,
    MAX_LINK_TARGET_NS,
    SETTLED_NS,
    AccuracyTarget,
)

MS, S = 1_000_000, 1_000_000_000
TOLERANCE_NS = 100_000
WANTED_NS = TOLERANCE_NS


def known_to(error_ns: float) -> TimeMap:
    """A clock that is known so well, now and for the next while."""
    return TimeMap(0, 0, 0.0, error_ns, 1e9 * error_ns, 0.0, 0.0, 300, 1000)


def seconds_until_settled(target: AccuracyTarget, errors_ns: list[float]) -> float | None:
    """Judge an error every 100 ms; return when asking quickly is over."""
    for tenth, error_ns in enumerate(errors_ns):
        if target.judge(known_to(error_ns), tenth * 100 * MS):
            return tenth / 10
    return None


def test_a_clock_that_is_good_enough_is_settled_at_once() -> None:
    target = AccuracyTarget(TOLERANCE_NS)
    assert not target.met
    assert target.judge(known_to(WANTED_NS), 0)
    assert target.met


def test_a_clock_that_becomes_better_is_asked_on() -> None:
    target = AccuracyTarget(TOLERANCE_NS)
    shrinking = [WANTED_NS * 10 * 0.95**n for n in range(100)]
    took_s = seconds_until_settled(target, shrinking)
    assert took_s is not None
    assert 4.0 < took_s < 5.0, "until it is good enough"
    assert target.met


def test_a_clock_that_does_not_become_better_is_settled_after_three_seconds_and_not_good_enough() -> None:
    target = AccuracyTarget(TOLERANCE_NS)
    errors_ns = [WANTED_NS * (20.0 if n < 10 else 17.0 + n % 2) for n in range(200)]
    assert seconds_until_settled(target, errors_ns) == 4.0
    assert not target.met


def test_no_clock_is_asked_quickly_for_ever() -> None:
    target = AccuracyTarget(TOLERANCE_NS)
    took_s = seconds_until_settled(target, [WANTED_NS * 1e6 * 0.98**n for n in range(400)])
    assert took_s == 15.0
    assert not target.met


def test_an_error_at_the_limit_does_not_flicker_and_a_large_one_is_reported() -> None:
    target = AccuracyTarget(TOLERANCE_NS)
    target.judge(known_to(0.9 * WANTED_NS), 0)
    target.judge(known_to(LEAVE_AT * WANTED_NS), S)
    assert target.met
    target.judge(known_to(1.01 * LEAVE_AT * WANTED_NS), 2 * S)
    assert not target.met
    target.judge(known_to(1.01 * WANTED_NS), 3 * S)
    assert not target.met
    target.judge(known_to(WANTED_NS), 4 * S)
    assert target.met


def over(round_trip_ns: int, error_ns: float) -> TimeMap:
    """A clock that is known so well over a link of this minimum round trip."""
    return replace(known_to(error_ns), round_trip_ns=round_trip_ns)


def test_by_default_the_target_is_what_the_link_can_bear() -> None:
    target = AccuracyTarget(min_ns=TOLERANCE_NS)
    for round_trip_ns, bears_ns in (
        (200_000, TOLERANCE_NS),
        (2_000_000, LINK_MARGIN * SIGMAS_95 * ASYMMETRY * 1_000_000),
        (50_000_000, MAX_LINK_TARGET_NS),
    ):
        target.restart()
        target.judge(over(round_trip_ns, 1e9), 0)
        assert target.target_ns == bears_ns
        assert not target.judge(over(round_trip_ns, 0.9 * bears_ns), 1) or bears_ns == TOLERANCE_NS
        assert target.judge(over(round_trip_ns, 0.9 * bears_ns), 1 + SETTLED_NS), "it gains no more"
        assert target.met


def test_without_a_tolerance_any_clock_will_do() -> None:
    target = AccuracyTarget()
    assert target.met
    assert target.judge(known_to(1e12), 0)


def test_another_leader_is_judged_anew() -> None:
    target = AccuracyTarget(TOLERANCE_NS)
    target.judge(known_to(WANTED_NS / 2), 0)
    target.restart()
    assert not target.met
    assert not target.judge(known_to(WANTED_NS * 2), 30 * S), "its three seconds begin now"


def test_a_rate_that_is_not_known_yet_counts_as_it_will_when_pictures_are_taken() -> None:
    target = AccuracyTarget(TOLERANCE_NS)
    now, later = 0.9 * WANTED_NS, 0.6 * WANTED_NS
    sure = TimeMap(0, 0, 0.0, now, 1e9, later / AHEAD_NS, 1.0, 300, 1000)
    assert sure.uncertainty_at(0) < WANTED_NS < sure.uncertainty_at(AHEAD_NS)
    assert not target.judge(sure, 0)
    assert target.error_ns == sure.uncertainty_at(AHEAD_NS)
