"""Rule for frames of several cameras to belong to one instant: within half a frame period."""

COMPARED_MS = 66.0
"""Delay of one camera that synchronized images are compared with by default, ms: two frames at 30 fps."""


def is_same_instant(apart: float, period: float) -> bool:
    """Whether two frames, or a frame and an instant, `apart` in time belong to one instant; same units.

    The frame of the next or previous period is then never nearer, so the nearest frame is the right one.
    """
    return abs(apart) <= period / 2
