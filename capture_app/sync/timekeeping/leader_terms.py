"""The terms of its leader as a client uses them: the grid of instants and the way to the root's time."""

from dataclasses import dataclass

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.goal import MAX_PERIOD_NS, MIN_PERIOD_NS, Goal
from capture_app.sync.wire.messages import Terms


@dataclass(frozen=True, slots=True)
class LeaderTerms:
    """The terms of its leader, or relay, as a client uses them; times in ns."""

    leader: int
    path: tuple[int, ...]
    """Instances from the root to this leader."""
    goal: Goal
    align_row: float | None
    meeting_leader_ns: int | None
    pace_ns: int
    upstream: TimeMap | None
    """From the leader's clock to the root's; None where it is the root."""
    in_holdover: bool

    @classmethod
    def of_message(cls, terms: Terms) -> "LeaderTerms | None":
        """Return the terms of a welcome or an acknowledgement; None where they cannot be right."""
        told = terms.upstream
        upstream = None if told is None else told.time_map()
        if (told is not None and upstream is None) or not MIN_PERIOD_NS <= terms.period_ns <= MAX_PERIOD_NS:
            return None
        return cls(
            leader=terms.leader,
            path=(terms.leader,) if told is None else (*told.path, terms.leader),
            goal=Goal(terms.anchor_leader_ns, terms.period_ns),
            align_row=terms.align_row,
            meeting_leader_ns=terms.meeting_leader_ns,
            pace_ns=terms.pace_ns,
            upstream=upstream,
            in_holdover=terms.in_holdover,
        )

    def root_map(self, own: TimeMap) -> TimeMap:
        """Return the map to the root's clock; `own` is the one to the leader's."""
        return own if self.upstream is None else own.chained_to(self.upstream)
