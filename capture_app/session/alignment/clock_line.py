"""Offset and rate of a camera's clock against another's, fitted to common events, directly or via others."""

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import TypeVar

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.format.common_times import REFERENCE, CameraTimes
from capture_app.session.format.lens import Array

Track = TypeVar("Track")
"""What is read from a camera's recording."""
Against = Callable[[str, str], CameraTimes]
"""Measures the second of two cameras, by name, against the first."""

CRYSTAL_PPM = 50.0
"""Prior on the rate error of camera clocks, ppm; one standard deviation."""
STEPS = 30
CAUCHY = 2.5
"""Residual in standard deviations at which a moment has half its weight."""
SIGMAS = 1.96


def fit_clock_line(
    camera_s: Array, reference_s: Array, sd_s: Array, source: str, *, systematic_s: float = 0.0
) -> CameraTimes:
    """Fit offset and rate to moments that both cameras recorded: robust least squares, Cauchy weights.

    The moments (n,) are in s, by each camera's own times; `sd_s` is the standard deviation of each pair. The
    uncertainties returned are 95 %.

    A short recording hardly determines the rate, so CRYSTAL_PPM serves as its prior. `systematic_s` (95 %) is
    an error common to all moments, which averaging does not reduce.
    """
    late = reference_s - camera_s
    epoch = float(np.average(camera_s, weights=1 / sd_s**2))
    rows = np.column_stack([np.ones(len(late)), camera_s - epoch])
    (offset, rate), covariance = fit_robustly(rows, late, sd_s, np.array([np.inf, CRYSTAL_PPM * 1e-6]))
    sigmas = SIGMAS + 2.5 / max(1, len(late) - 1)
    return CameraTimes(
        offset_ns=round(float(offset) * 1e9),
        uncertainty_ns=round((sigmas * float(np.sqrt(covariance[0, 0])) + systematic_s) * 1e9),
        rate_ppm=round(float(rate) * 1e6, 4),
        rate_uncertainty_ppm=round(sigmas * float(np.sqrt(covariance[1, 1])) * 1e6, 4),
        epoch_local_ns=round(epoch * 1e9),
        source=source,
    )


def fit_robustly(rows: Array, target: Array, sd: Array, prior_sd: Array) -> tuple[Array, Array]:
    """Fit `rows` (n, k) times the returned values (k,) to `target` (n,), whose deviations are `sd` (n,).

    Least squares with Cauchy weights, and a prior around 0 of deviation `prior_sd` (k,) for each value, inf
    for none. Also return the values' covariance (k, k).
    """
    weights, scale = np.ones(len(target)), 1.0
    for _ in range(STEPS):
        total = weights / (scale * sd) ** 2
        normal = rows.T @ (total[:, None] * rows) + np.diag(prior_sd**-2.0)
        values = np.asarray(np.linalg.solve(normal, rows.T @ (total * target)), float)
        miss = (target - rows @ values) / sd
        residual_scale = 1.4826 * np.median(np.abs(miss)) if len(miss) > 4 else np.sqrt(np.mean(miss**2))
        scale = max(1.0, float(residual_scale))
        weights = 1 / (1 + (miss / (CAUCHY * scale)) ** 2)
    return values, np.asarray(np.linalg.inv(normal), float)


def measure_pairs(read: Callable[[str], Track], match: Callable[[Track, Track], CameraTimes]) -> Against:
    """Return how two cameras compare by what `read` finds in each; its BadInputError is the reason if not.

    Each camera is read once, and each pair matched once.
    """

    @cache
    def found(name: str) -> tuple[Track | None, str]:
        try:
            return read(name), ""
        except BadInputError as error:
            return None, error.what

    @cache
    def against(first: str, second: str) -> CameraTimes:
        (one, lacks), (other, other_lacks) = found(first), found(second)
        if one is None or other is None:
            return CameraTimes(reason=f"{first}: {lacks}" if one is None else other_lacks)
        return match(one, other)

    return against


def chain_cameras(names: Sequence[str], against: Against) -> dict[str, CameraTimes]:
    """Return each camera's times against the first camera's, through a chain of measured pairs.

    `against(first, second)` measures the second camera's times against the first's.

    Each camera uses the chain of pairs with the smallest uncertainty; the uncertainties of a chain add up.
    """
    last = names[0]
    known = {last: CameraTimes(offset_ns=0, uncertainty_ns=0, rate_uncertainty_ppm=0.0, source=REFERENCE)}
    why: dict[str, str] = {}
    waiting: dict[str, CameraTimes] = {}

    def error_ns(name: str) -> int:
        return waiting[name].uncertainty_ns or 0

    while True:
        for name in names:
            # A pair takes long to measure, and a nearly as good measurement needs no improvement.
            if name in known or (name in waiting and error_ns(name) <= 2 * (known[last].uncertainty_ns or 0)):
                continue
            measured = against(last, name)
            if measured.offset_ns is None:
                why.setdefault(name, measured.reason)
                continue
            chained = measured if last == names[0] else compose(known[last], measured)
            if name not in waiting or (chained.uncertainty_ns or 0) < error_ns(name):
                waiting[name] = chained
        if not waiting:
            return {name: known.get(name) or CameraTimes(reason=why.get(name, "")) for name in names}
        last = min(waiting, key=error_ns)
        known[last] = waiting.pop(last)


def compose(outer: CameraTimes, inner: CameraTimes) -> CameraTimes:
    """Chain two alignments: a camera's against another (`inner`), and that other's against the reference."""
    epoch = inner.epoch_local_ns
    middle_ns = inner.leader_from_local(epoch)
    return CameraTimes(
        offset_ns=outer.leader_from_local(middle_ns) - epoch,
        uncertainty_ns=round(math.hypot(outer.uncertainty_at_ns(middle_ns) or 0, inner.uncertainty_ns or 0)),
        rate_ppm=outer.rate_ppm + inner.rate_ppm,
        rate_uncertainty_ppm=math.hypot(outer.rate_uncertainty_ppm or 0.0, inner.rate_uncertainty_ppm or 0.0),
        epoch_local_ns=epoch,
        source=inner.source,
    )
