"""How measured depth compares with true depth."""

import numpy as np

from reconstruction.common.geometry import Array


def true_depth_in_unit(truth: Array, unit: str, still: Array, static: Array) -> Array | None:
    """True depth (m, 0 or not finite = unknown) in the calibration's unit, NaN = unknown.

    Structure from motion knows no metres: there, what stands still (`static`, bool) gives the scale by its
    depth `still` (0 = unknown). None where none of that is known.
    """
    known = np.where(np.isfinite(truth) & (truth > 0), truth, np.nan)
    if unit == "m":
        return known
    both = static & (still > 0) & np.isfinite(known)
    return known * float(np.median(still[both] / known[both])) if both.any() else None
