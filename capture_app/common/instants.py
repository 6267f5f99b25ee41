"""The rule by which frames of several cameras belong to one instant: within half a frame period."""


def is_same_instant(apart: float, period: float) -> bool:
    """Whether two frames, or a frame and an instant, so far apart are of one instant; same units of time.

    A frame one period earlier or later is then always farther away, so the nearest frame is the right one.
    """
    return abs(apart) <= period / 2
