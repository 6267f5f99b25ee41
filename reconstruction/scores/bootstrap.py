"""Bootstrap intervals over the instants of a burst; all conditions use the same draws, and stay paired."""

from collections.abc import Callable

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.scores.results import Interval

RESAMPLES = 500
LEVEL_PERCENT = 95.0


def draw_instants(instants: int) -> Array:
    """Instants drawn with replacement (RESAMPLES, instants); the same number gives the same draws."""
    return np.random.default_rng(0).integers(0, instants, (RESAMPLES, instants))


def share_samples(parts: Array, wholes: Array) -> Array:
    """The pooled share, sum of parts over sum of wholes, of every draw (RESAMPLES,); NaN = nothing there."""
    drawn = draw_instants(len(parts))
    total = wholes[drawn].sum(1)
    return np.asarray(np.where(total > 0, parts[drawn].sum(1) / np.maximum(total, 1), np.nan))


def pooled_samples(values: list[Array], estimate: Callable[[Array], float]) -> Array:
    """An estimate over the pooled values (one array for each instant) of every draw (RESAMPLES,)."""
    found = np.full(RESAMPLES, np.nan)
    for i, drawn in enumerate(draw_instants(len(values))):
        pooled = np.concatenate([values[k] for k in drawn])
        if len(pooled):
            found[i] = estimate(pooled)
    return found


def bootstrap_interval(value: float | None, samples: Array) -> Interval | None:
    """The middle 95 % of the draws around a value; None where there is no value or only one instant."""
    known = samples[np.isfinite(samples)]
    if value is None or not len(known):
        return None
    rest = (100 - LEVEL_PERCENT) / 2
    low, high = np.percentile(known, [rest, 100 - rest])
    return Interval(value=value, low=float(min(low, value)), high=float(max(high, value)))
