"""The clock whose rate is changed from outside."""

from benchmarks.simulated.changing_clocks import ChangingClock, RateSpell

S = 1_000_000_000


def test_a_rate_change_is_applied_while_it_lasts_and_its_offset_stays() -> None:
    clock = ChangingClock(7 * S, 20e-6, 100 * S, (RateSpell(120 * S, 220 * S, 500e-6),))
    gained_us = [(clock.local_from_true(t * S) - t * S - 7 * S) / 1000 for t in (100, 120, 170, 220, 320)]
    assert gained_us == [0, 400, 400 + 26_000, 400 + 52_000, 400 + 54_000]


def test_a_drift_begins_at_the_epoch_and_grows_with_the_square() -> None:
    clock = ChangingClock(0, 0.0, 100 * S, drift_ppm_per_s=0.05)
    gained_ns = [clock.local_from_true(t * S) - t * S for t in (50, 100, 110, 160)]
    assert gained_ns == [0, 0, 2500, 90_000]
