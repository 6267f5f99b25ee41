"""How datagrams cross a link without a memory, drawn quickly: millions of them make a tree's hour."""

import random
from collections.abc import Callable, Sequence
from math import log

from capture_app.simulation.link import DelayLaw, Law, Link

Crossing = Callable[[random.Random], Sequence[int]]
"""Draws the delays in ns at which copies of one datagram arrive: none, one or two."""


def crossing(link: Link, law: Law) -> Crossing:
    """Return how datagrams of one direction cross: as `link.deliveries(law, rng)` says, drawn otherwise."""
    if link.loss or link.duplication or not isinstance(law, DelayLaw) or law.shape != 2.0:
        return lambda rng: link.deliveries(law, rng)
    minimum_ns, outlier_share, outlier_ns = law.minimum_ns, law.outlier_share, law.outlier_ns
    scale_ns = (law.mean_ns - minimum_ns) / 2.0

    def cross(rng: random.Random) -> tuple[int]:
        # Gamma of shape 2 is the sum of two exponentials.
        uniform = rng.random
        delay_ns = minimum_ns - scale_ns * log((1.0 - uniform()) * (1.0 - uniform()))
        if uniform() < outlier_share:
            delay_ns += uniform() * outlier_ns
        return (round(delay_ns),)

    return cross
