"""How many instants a burst gets, and how far apart, by what was asked for and the rig's frame period."""

from bisect import bisect_right

from capture_app.errors import BadInputError
from capture_app.node.wire.messages import BurstRequest
from capture_app.sync.rig.frame_picks import MAX_STREAMED_FRAMES, MAX_STREAMED_NS, Burst

LONG_NS = 2_000_000_000
END_LEAD_NS = 300_000_000
NEAR = 0.02
"""A rate that differs by no more than this share is the one that was asked for."""


def frames_and_spacing(request: BurstRequest, period_ns: int) -> tuple[int, int]:
    """Return the number of frames, and every how many of the rig's frames one is taken.

    Raises BadInputError for an interval that is not a whole number of periods.
    """
    spacing = request.spacing
    if request.interval_s is not None:
        periods = request.interval_s * 1e9 / period_ns
        spacing = max(1, round(periods))
        if abs(spacing - periods) > NEAR * periods:
            fps = 1e9 / period_ns
            rates = ", ".join(f"{fps / n:.4g}" for n in (1, 2, 3, 4, 5))
            raise BadInputError(
                f"the rig takes {fps:.4g} frames a second, of which {1 / request.interval_s:.4g} cannot be",
                hint=f"take every frame or every nth: {rates} ...",
            )
    step_ns = spacing * period_ns
    if request.frames is not None:
        return request.frames, spacing
    if request.seconds is not None:
        return max(1, round(request.seconds * 1e9 / step_ns)), spacing
    return min(MAX_STREAMED_FRAMES, MAX_STREAMED_NS // step_ns), spacing


def is_streamed(request_spare: int | None, frames: int, step_ns: int) -> bool:
    """Whether the frames of a burst are sent as they come: it is long, and no spare were asked for."""
    return not request_spare and (frames - 1) * step_ns > LONG_NS


def frames_until(burst: Burst, now_ns: int) -> int:
    """How many frames a burst has that is to end now, and of whose end every node must hear before."""
    return max(1, bisect_right(burst.instants_ns, now_ns + END_LEAD_NS))


def first_instant(request: BurstRequest, asked_ns: int, step_ns: int) -> int | None:
    """Return the leader time about which a burst that was asked for then begins, with steps of `step_ns`.

    None: as soon as all nodes can know of it.
    """
    if not request.before or not step_ns:
        return request.at_leader_ns
    at_ns = asked_ns if request.at_leader_ns is None else request.at_leader_ns
    return at_ns - request.before * step_ns
