"""Whether a clock is known as well as was asked for, and whether asking on quickly still helps."""

from capture_app.sync.clock.time_map import TimeMap

CLOCK_SHARE = 1.0
"""The share of a node's tolerance that the 95 % error of its clock may take. All of it: the phase is held to
the tolerance by that clock, so a picture is off by both, and its record says by how much each."""
LEAVE_AT = 1.5
"""A clock that was good enough is so until its error is so many times what was asked for: an estimate of an
error varies by as much from one second to the next."""
AHEAD_NS = 500_000_000
"""A clock is judged by its error so much later: the pictures of a burst that is asked for now come then. Soon
after the first answers the rate is not known well enough for that."""
GAIN, PATIENCE_NS = 0.9, 3_000_000_000
"""An error that does not become smaller by a tenth within so long will not become much smaller."""
LONGEST_NS = 15_000_000_000
"""No node asks its leader in quick succession for longer."""


class AccuracyGoal:
    """Compares the 95 % error of a clock with what was asked for; times in ns, `now_ns` the node's own."""

    def __init__(self, wanted_ns: float | None = None) -> None:
        """Without `wanted_ns` every clock is good enough."""
        self.wanted_ns = wanted_ns
        self.met = wanted_ns is None
        """Whether the clock is good enough."""
        self.error_ns: float | None = None
        """The 95 % error by which it was judged last."""
        self._least_ns: float | None = None
        self._began_ns = self._gained_ns = 0

    @classmethod
    def for_tolerance(cls, tolerance_ns: int) -> "AccuracyGoal":
        """Return the goal of a node whose frames are to be within a tolerance."""
        return cls(CLOCK_SHARE * tolerance_ns)

    def restart(self) -> None:
        """Judge anew: there is another leader, or a clock has stepped."""
        self.met = self.wanted_ns is None
        self._least_ns = None

    def judge(self, time_map: TimeMap, now_ns: int) -> bool:
        """Take in the newest estimate; whether it is good enough, or will not become much better."""
        error_ns = self.error_ns = time_map.uncertainty_at(now_ns + AHEAD_NS)
        if self.wanted_ns is None:
            return True
        self.met = error_ns <= self.wanted_ns * (LEAVE_AT if self.met else 1.0)
        if self._least_ns is None:
            self._began_ns = now_ns
        if self._least_ns is None or error_ns < GAIN * self._least_ns:
            self._least_ns, self._gained_ns = error_ns, now_ns
        over = now_ns - self._gained_ns >= PATIENCE_NS or now_ns - self._began_ns >= LONGEST_NS
        return self.met or over
