"""What crossings of epipolar lines agree on, among wrong matches and with a calibration that is off."""

import numpy as np
import pytest

from reconstruction.time_offsets.crossings import Crossings, StillErrors, fit_offset

PERIOD_MS = 20.0


def crossings(
    offset_ms: float,
    *,
    right: int = 60,
    wrong: int = 60,
    shift_px: float = 0.0,
    instants: int = 8,
    seed: int = 0,
) -> Crossings:
    """Points that cross their line up- and downwards at other speeds; wrong ones cross it at any time."""
    rng = np.random.default_rng(seed)
    speed = rng.choice([-1, 1], right + wrong) * rng.uniform(0.1, 0.6, right + wrong)
    found = offset_ms + (shift_px + rng.normal(0, 0.3, right + wrong)) / speed
    found[right:] = rng.uniform(-150, 150, wrong)
    return Crossings(rng.integers(0, instants, right + wrong), found, speed)


def test_the_error_bar_holds_the_error() -> None:
    misses = []
    for seed, offset_ms in enumerate(np.linspace(-80, 80, 30)):
        found = fit_offset(crossings(float(offset_ms), seed=seed), StillErrors(), PERIOD_MS)
        assert found.offset_ms is not None, found.reason
        assert found.sd_ms is not None
        misses.append((found.offset_ms - offset_ms) / found.sd_ms)
    assert np.sqrt(np.mean(np.square(misses))) < 1.4
    assert np.max(np.abs(misses)) < 4


def test_a_calibration_that_is_off_is_no_lateness() -> None:
    found = fit_offset(crossings(5.0, shift_px=1.5), StillErrors(1.4, 0.3), PERIOD_MS)
    assert found.offset_ms == pytest.approx(5.0, abs=1)
    rng = np.random.default_rng(1)
    speed = np.full(60, 0.4)
    one_way = Crossings(rng.integers(0, 8, 60), 5.0 + (1.5 + rng.normal(0, 0.3, 60)) / speed, speed)
    known, unknown = (
        fit_offset(one_way, still, PERIOD_MS) for still in (StillErrors(1.5, 0.2), StillErrors())
    )
    assert known.offset_ms == pytest.approx(5.0, abs=1.5)
    assert known.sd_ms is not None
    assert unknown.sd_ms is not None
    # What moves at one speed cannot tell lateness from a calibration that is off, unless that is known.
    assert unknown.sd_ms > 2 * known.sd_ms


def test_nothing_is_said_where_nothing_agrees() -> None:
    nothing = fit_offset(crossings(0.0, right=0, wrong=0), StillErrors(), PERIOD_MS)
    assert nothing.offset_ms is None
    assert "too few moving points" in nothing.reason
    chance = [
        fit_offset(crossings(0.0, right=0, wrong=120, seed=s), StillErrors(), PERIOD_MS) for s in range(20)
    ]
    assert sum(found.offset_ms is not None for found in chance) <= 1
    alone = fit_offset(crossings(3.0, instants=1), StillErrors(), PERIOD_MS)
    assert alone.offset_ms is None
    assert "it takes 3" in alone.reason


def test_one_instant_that_disagrees_does_not_move_the_result() -> None:
    good, late = crossings(0.0, wrong=0, instants=6), crossings(15.0, right=30, wrong=0, instants=1)
    odd = Crossings(late.instant + 6, late.offset_ms, late.across_px_per_ms)
    found = fit_offset(Crossings.join([good, odd]), StillErrors(0.0, 0.2), PERIOD_MS)
    assert found.offset_ms == pytest.approx(0.0, abs=1)
    assert found.instants[-1].offset_ms == pytest.approx(15.0, abs=2)
