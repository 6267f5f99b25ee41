"""Matches of descriptors of two images."""

import numpy as np

from capture_app.session.format.lens import Array


def match_descriptors(a: Array, b: Array, ratio: float) -> tuple[Array, Array]:
    """Return the indices (n,) of descriptors that are each other's best match, with Lowe's ratio test."""
    if len(a) < 2 or len(b) < 2:
        return np.zeros(0, int), np.zeros(0, int)
    # Squared distances without the own squared length; in both directions, as reading rows is faster.
    own, others, doubled = (a**2).sum(1), (b**2).sum(1), -2 * b
    ahead, back = a @ doubled.T, doubled @ a.T
    ahead += others
    back += own
    best = ahead.argmin(1)
    rows = np.arange(len(best))
    mutual = back.argmin(1)[best] == rows
    first = ahead[rows, best] + own
    ahead[rows, best] = np.inf
    keep = mutual & (first < ratio**2 * (ahead.min(1) + own))
    return rows[keep], best[keep]
