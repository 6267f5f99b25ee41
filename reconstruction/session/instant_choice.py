"""Which instants of a burst are measured: those at which something moves."""

from collections.abc import Sequence

from reconstruction.session.frame_offset import evenly_spread
from reconstruction.session.mover_detection import SceneMotion

CANDIDATES = 4
"""So many times as many instants as are wanted are looked at,"""
LEAST_CANDIDATES = 16
"""and no fewer than these."""
LEAST_MOVING = 0.0001
"""Share of the picture that must move before every one of the cameras."""
FEWEST = 3
"""Where fewer instants show that much motion, those that show most of it are taken."""


def choose_moving_instants(
    motion: SceneMotion, cameras: Sequence[str], instants: Sequence[int], limit: int
) -> list[int]:
    """At most `limit` of the instants, spread evenly over those at which something moves before all cameras.

    All cameras must have an image at each of them. Where nothing moves, they are spread over all.
    """
    looked_at = evenly_spread(instants, max(LEAST_CANDIDATES, CANDIDATES * limit))
    shares = {k: min(float(motion.detected_movers(name, k).mean()) for name in cameras) for k in looked_at}
    moving = [k for k in looked_at if shares[k] >= LEAST_MOVING]
    if len(moving) < min(FEWEST, limit):
        most = sorted(looked_at, key=lambda k: -shares[k])[: min(FEWEST, limit)]
        moving = sorted(k for k in most if shares[k] > 0)
    return evenly_spread(moving or list(instants), limit)
