"""When a node that only keeps the time asks for it: at once, and then in rounds, ever further apart."""

from capture_app.sync.clock.time_map import TimeMap

_MS = 1_000_000
NEVER_NS = 2**62
FIRST_EXCHANGES = 300
LEARNING_EXCHANGES = 40
ROUND_EXCHANGES = 50
LEAST_EXCHANGES = 10
SPACING_NS = 4 * _MS
SETTLE_NS = 60 * _MS
"""From a round's last request to the estimate."""
SHORTEST_NS, LONGEST_NS = 2_000 * _MS, 60_000 * _MS
"""Between two rounds of a leader's pace."""
FIRST_NS = 500 * _MS
GROWTH = 1.2
"""A round is so much later than the one before it, until the leader's pace is reached: as the skew shows.

So no guess reaches further ahead than a fifth of the time that the clock was watched."""


class Rounds:
    """The times of requests and estimates; `now_ns` is the node's own clock."""

    def __init__(self) -> None:
        self.request_due_ns = self.settle_due_ns = NEVER_NS
        self._left = 0
        self._every_ns = 0

    def begin(self, now_ns: int) -> None:
        """Start anew, with a first round of many requests."""
        self._left, self._every_ns = FIRST_EXCHANGES, 0
        self.request_due_ns, self.settle_due_ns = now_ns, NEVER_NS

    def restart(self, now_ns: int) -> None:
        """Ask as if for the first time, from the next request on: a clock has stepped."""
        self._left, self._every_ns = FIRST_EXCHANGES, 0
        self.request_due_ns = min(self.request_due_ns, now_ns + SPACING_NS)

    def asked(self, now_ns: int, pace_ns: int, slot: float, time_map: TimeMap | None) -> bool:
        """Note a request, and fix when the next one is due; True for the last one of a round.

        `pace_ns` is the mean time between two requests that the leader bears, `slot` the part of the time
        between two rounds, 0 to 1, at which this node's begin.
        """
        self._left -= 1
        if self._left > 0:
            self.request_due_ns = now_ns + SPACING_NS
            return False
        self.settle_due_ns = now_ns + SETTLE_NS
        longest_ns = min(max(ROUND_EXCHANGES * pace_ns, SHORTEST_NS), LONGEST_NS)
        self._every_ns = min(max(round(self._every_ns * GROWTH), FIRST_NS), longest_ns)
        share = longest_ns // max(pace_ns, longest_ns // ROUND_EXCHANGES)
        most = share if self._every_ns == longest_ns else min(share, LEARNING_EXCHANGES)
        self._left = max(most, LEAST_EXCHANGES)
        self.request_due_ns = now_ns + self._every_ns
        if self._every_ns == longest_ns and time_map is not None:
            # All count from the root's time, each in its slot, so that no two begin together.
            past_ns = time_map.leader_from_local(self.request_due_ns)
            self.request_due_ns -= (past_ns - round(slot * longest_ns)) % longest_ns
            if self.request_due_ns < now_ns + longest_ns // 4:
                self.request_due_ns += longest_ns
        return True
