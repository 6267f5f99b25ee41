"""How measured depth compares with true depth, and what counts as right."""

import numpy as np

from reconstruction.common.geometry import Array

DEPTH_TOLERANCE = 0.02
"""Greatest relative error of a depth that is called right."""
TOLERANCE_TEXT = f"within {100 * DEPTH_TOLERANCE:g} %"
TOLERANCES = {"within_1pct": 0.01, "within_2pct": DEPTH_TOLERANCE, "within_5pct": 0.05}
"""By measure of `metrics.json`."""


def right_depth(depth: Array, truth: Array, tolerance: float = DEPTH_TOLERANCE) -> Array:
    """Where depth is right (bool); it is not where there is none, or no true depth (0 or not finite)."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(depth - truth) < tolerance * truth)


def share_right(depth: Array, truth: Array, mask: Array | None = None) -> float | None:
    """Share of a mask's pixels (bool) with a true depth (0 = unknown) whose depth is right; None = none."""
    known = truth > 0 if mask is None else (truth > 0) & mask
    return float(right_depth(depth, truth)[known].mean()) if known.any() else None


def depth_shares(depth: Array, truth: Array, movers: Array) -> dict[str, float | None]:
    """Shares of a depth map by a true one (0 = unknown) and a mask of what moves, all height x width."""
    known, there = truth > 0, (depth > 0) & (truth > 0)
    error = np.abs(depth - truth)[there] / truth[there]
    on_movers = known & movers
    shares = {
        "within_2pct": share_right(depth, truth),
        "mover_within_2pct": share_right(depth, truth, movers),
        "static_within_2pct": share_right(depth, truth, ~movers),
        "mover_coverage": float(there[on_movers].mean()) if on_movers.any() else None,
        "median_error_pct": 100 * float(np.median(error)) if error.size else None,
    }
    return {name: None if share is None else round(share, 4) for name, share in shares.items()}


def true_depth_in_unit(truth: Array, unit: str, still: Array, static: Array) -> Array | None:
    """True depth (m, 0 = unknown) in the calibration's unit, NaN = unknown.

    Structure from motion knows no metres: there, what stands still (`static`, bool) gives the scale by its
    depth `still` (0 = unknown). None where none of that is known.
    """
    known = np.where(truth > 0, truth, np.nan)
    if unit == "m":
        return known
    both = static & (still > 0) & np.isfinite(known)
    return known * float(np.median(still[both] / known[both])) if both.any() else None
