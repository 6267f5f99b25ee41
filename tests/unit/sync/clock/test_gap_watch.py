"""The gap of a line: what two clocks leave of it, and what a path does."""

import random

import pytest

from benchmarks.simulated.link_spells import LAWS
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.gap_watch import WATCHED_NS, Cause, GapWatch, LineGap, cause_of

MS, S = 10**6, 10**9
BEFORE = LineGap(10 * S, 1_000_000.0, 10_000.0)


def watched(*gaps: LineGap) -> GapWatch:
    """A watch that has seen these gaps."""
    watch = GapWatch()
    for gap in gaps:
        watch.add(gap)
    return watch


def test_a_gap_is_too_small_beyond_chance_and_a_change_of_the_path() -> None:
    watch = watched(BEFORE)
    assert watch.before(BEFORE.least - 1.0, is_alert=False) == BEFORE
    assert watch.before(BEFORE.least + 1.0, is_alert=False) is None
    assert watched(BEFORE._replace(sigma=100_000.0)).before(BEFORE.least - 1.0, is_alert=False) is None, (
        "by chance"
    )


def test_after_a_change_a_smaller_loss_is_looked_into() -> None:
    watch, gap_ns = watched(BEFORE), BEFORE.gap - 2.0 * BEFORE.sigma
    assert watch.before(gap_ns, is_alert=False) is None
    assert watch.before(gap_ns, is_alert=True) == BEFORE
    assert watch.before(BEFORE.gap - BEFORE.sigma, is_alert=True) is None


def test_the_newest_large_gap_is_found() -> None:
    gaps = [LineGap(second * S, 1_000_000.0 - 1_000.0 * second, 1_000.0) for second in range(20)]
    found = watched(*gaps).before(gaps[7].least - 1.0, is_alert=False)
    assert found == gaps[7]
    assert watched(*gaps, LineGap(20 * S, 1_000_000.0, 1_000.0)).before(gaps[19].least, is_alert=False) == (
        20 * S,
        1_000_000.0,
        1_000.0,
    ), "the last one, and larger than all"


def test_a_gap_of_long_ago_is_forgotten() -> None:
    watch = watched(BEFORE, LineGap(BEFORE.local_ns + WATCHED_NS + 1, 500_000.0, 1_000.0))
    assert watch.before(600_000.0, is_alert=False) is None
    assert watch.path_ns == 500_000.0


def test_what_a_change_takes_from_the_gap_is_not_taken_for_the_path() -> None:
    watch = watched(BEFORE)
    watch.add(LineGap(BEFORE.local_ns + S, 600_000.0, 1_000.0), is_of_path=False)
    assert watch.path_ns == BEFORE.gap
    watch.add(LineGap(BEFORE.local_ns + 2 * S, 500_000.0, 1_000.0))
    watch.restart(BEFORE.local_ns + 3 * S)
    assert watch.path_ns == BEFORE.gap


def test_a_line_after_a_change_is_compared_with_the_surest_gap_before_it() -> None:
    watch = watched(BEFORE, LineGap(BEFORE.local_ns + S, 700_000.0, 50_000.0))
    watch.restart(BEFORE.local_ns + 2 * S)
    same = watch.before(BEFORE.least - 1.0, is_alert=False)
    assert same == BEFORE._replace(local_ns=BEFORE.local_ns + 2 * S)


@pytest.mark.parametrize(
    ("gap_us", "sigma_us", "cause"),
    [
        (990, 10, Cause.CLOCK),
        (705, 10, Cause.PATH),
        (850, 10, None),
        (990, 200, None),
        (1_500, 200, Cause.CLOCK),
    ],
)
def test_the_newest_samples_tell_a_clock_from_a_path(
    gap_us: float, sigma_us: float, cause: Cause | None
) -> None:
    assert cause_of(BEFORE, 700_000.0, LineGap(11 * S, gap_us * 1e3, sigma_us * 1e3)) is cause


def test_a_queue_that_fills_is_not_reported_as_a_clock_step() -> None:
    rng, channel, clock = random.Random(1), LAWS["bufferbloat"](random.Random(1)).open(), ClockFilter()
    arrivals = []
    for t0 in range(0, 15 * S, 25 * MS):
        t1 = t0 + channel.deliveries("to_leader", t0, rng)[0]
        arrivals.append((t1 + channel.deliveries("to_client", t1, rng)[0], t0, t1))
    for number, (t3, t0, t1) in enumerate(sorted(arrivals)):
        assert clock.add(ClockSample(t0, t1, t1, t3))
        if number % 4 == 0:
            clock.time_map(t3)
    assert clock.changes.rate_changed_ns is None
