"""Offset and rate of a camera's times against another's, directly or through others, from common"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from capture_app.session.format.common_times import REFERENCE, CameraTimes

Array = NDArray[np.float64]

CRYSTAL_PPM = 50.0
"""How far clocks of cameras are off their rate, before it is measured; one standard deviation."""
STEPS = 30
SIGMAS = 1.96


def fit_clock_line(
    camera_s: Array, reference_s: Array, sd_s: Array, source: str, *, systematic_s: float = 0.0
) -> CameraTimes:
    """The offset and rate that most moments agree on: robust least squares (Cauchy weights), 95 % errors.

    Moments (n,) by the own times of two cameras that recorded them, and the error (sd) of each pair, s.

    A short recording hardly tells the rate: what is known of crystals stands in for what it does not.
    `systematic_s` (95 %) is what all moments share, and no number of them averages out.
    """
    late = reference_s - camera_s
    offset, scale = float(np.median(late)), 1.0
    # Before the rate is known, it moves moments far apart by more than their own error.
    rate, weights = 0.0, np.ones(len(late))
    epoch = float(np.average(camera_s, weights=1 / sd_s**2))
    away = camera_s - epoch
    for _ in range(STEPS):
        total = weights / (scale * sd_s) ** 2
        rows = np.column_stack([np.ones(len(late)), away])
        normal = rows.T @ (total[:, None] * rows)
        normal[1, 1] += 1 / (CRYSTAL_PPM * 1e-6) ** 2
        offset, rate = np.linalg.solve(normal, rows.T @ (total * late))
        miss = (late - rows @ np.array([offset, rate])) / sd_s
        spread = (
            1.4826 * float(np.median(np.abs(miss))) if len(miss) > 4 else float(np.sqrt(np.mean(miss**2)))
        )
        scale = max(1.0, spread)
        weights = 1 / (1 + (miss / (2.5 * scale)) ** 2)
    covariance = np.linalg.inv(normal)
    sigmas = SIGMAS + 2.5 / max(1, len(late) - 1)
    return CameraTimes(
        offset_ns=round(float(offset) * 1e9),
        uncertainty_ns=round((sigmas * float(np.sqrt(covariance[0, 0])) + systematic_s) * 1e9),
        rate_ppm=round(float(rate) * 1e6, 4),
        rate_uncertainty_ppm=round(sigmas * float(np.sqrt(covariance[1, 1])) * 1e6, 4),
        epoch_local_ns=round(epoch * 1e9),
        source=source,
    )


def chain_cameras(names: Sequence[str], against: Callable[[str, str], CameraTimes]) -> dict[str, CameraTimes]:
    """Each camera's times against the first's; `against` measures a pair, the second against the first.

    Each goes the way with the least error: directly, or through others; errors then add up.
    """
    last = names[0]
    known = {last: CameraTimes(offset_ns=0, uncertainty_ns=0, rate_uncertainty_ppm=0.0, source=REFERENCE)}
    why: dict[str, str] = {}
    waiting: dict[str, CameraTimes] = {}

    def error_ns(name: str) -> int:
        return waiting[name].uncertainty_ns or 0

    while True:
        for name in names:
            # What is known nearly as well already is not measured again: that takes long.
            if name in known or (name in waiting and error_ns(name) <= 2 * (known[last].uncertainty_ns or 0)):
                continue
            found = against(last, name)
            if found.offset_ns is None:
                why.setdefault(name, found.reason)
                continue
            way = found if last == names[0] else compose(known[last], found)
            if name not in waiting or (way.uncertainty_ns or 0) < error_ns(name):
                waiting[name] = way
        if not waiting:
            return {name: known.get(name) or CameraTimes(reason=why.get(name, "")) for name in names}
        last = min(waiting, key=error_ns)
        known[last] = waiting.pop(last)


def compose(outer: CameraTimes, inner: CameraTimes) -> CameraTimes:
    """The times of a camera against the reference, from those against another camera and that one's."""
    epoch = inner.epoch_local_ns
    middle_ns = inner.leader_from_local(epoch)
    outer_error = outer.uncertainty_at_ns(middle_ns) or 0
    return CameraTimes(
        offset_ns=outer.leader_from_local(middle_ns) - epoch,
        uncertainty_ns=round(math.hypot(outer_error, inner.uncertainty_ns or 0)),
        rate_ppm=outer.rate_ppm + inner.rate_ppm,
        rate_uncertainty_ppm=math.hypot(outer.rate_uncertainty_ppm or 0.0, inner.rate_uncertainty_ppm or 0.0),
        epoch_local_ns=epoch,
        source=inner.source,
    )
