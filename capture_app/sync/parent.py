"""Whom a node that only keeps the time follows: what it told of itself, and what it was asked."""

from dataclasses import dataclass, field

from capture_app.sync.messages import HeartbeatAck, Welcome
from capture_app.sync.onward import MAX_DEPTH
from capture_app.sync.timebase import MAX_PERIOD_NS, MIN_PERIOD_NS, TimeMap


@dataclass(slots=True)
class Parent:
    """What the parent told when it took this node in; a leader's path is itself, a relay's begins there."""

    leader: int
    client: int
    slot: float
    pace_ns: int
    path: tuple[int, ...]
    onward: TimeMap | None
    synced: bool = False
    heard_ns: int = 0
    answers: int = 0
    """Time replies since the last round began."""
    outstanding: dict[int, int] = field(default_factory=dict)


def terms_of(message: Welcome | HeartbeatAck) -> tuple[tuple[int, ...], TimeMap | None] | None:
    """Return a parent's path and the map from its clock to the root's; None if nobody can follow it."""
    told = message.onward
    path = (message.leader,) if told is None else (*told.path, message.leader)
    onward = None if told is None else told.time_map()
    if len(path) > MAX_DEPTH or not MIN_PERIOD_NS <= message.period_ns <= MAX_PERIOD_NS:
        return None
    return None if told is not None and onward is None else (path, onward)
