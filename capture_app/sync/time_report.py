"""What a node reports of its time, whether it has a camera or not."""

from capture_app.sync.messages import Report
from capture_app.sync.state import NodeState
from capture_app.sync.timebase import TimeMap


def time_report(
    state: NodeState, message: str, time_map: TimeMap | None, samples: int, now_ns: int
) -> Report:
    """Return a report without a camera's part; `now_ns` is the node's own clock, `samples` those in use."""
    message = message[:200]
    if time_map is None:
        return Report(state=state, message=message, samples=samples)
    return Report(
        state=state,
        message=message,
        offset_ns=_told(time_map.leader_from_local(now_ns) - now_ns),
        skew_ppm=time_map.skew * 1e6,
        uncertainty_ns=_told(time_map.uncertainty_at(now_ns)),
        hard_bound_ns=_told(time_map.hard_bound_at(now_ns)),
        round_trip_ns=time_map.round_trip_ns,
        samples=samples,
    )


def _told(value_ns: float) -> int | None:
    """Return it as a whole number; None where no message can carry it: a forged clock may show anything."""
    return round(value_ns) if abs(value_ns) < 2**63 else None
