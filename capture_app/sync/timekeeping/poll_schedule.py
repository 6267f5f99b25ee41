"""When a client sends time requests: at a steady rate as cameras need it, or ever more rarely.

Also whether its clock is as accurate as requested, and whether further quick requests would improve it.
"""

from typing import NamedTuple

from capture_app.sync.clock.time_map import TimeMap

AT_ONCE_NS, NEVER_NS = -(2**62), 2**62
"""Before and after any time of any clock: a local clock may well be negative."""
FIRST_SAMPLES = 300
"""K of the paper: as many samples at least are taken in quick succession."""
FIRST_PACE_NS = 3_000_000
PACE_NS = 25_000_000
EASING_PACES_NS, EASING_SAMPLES = (6_000_000, 12_000_000), 200
"""Between the two, so many samples at each of these: until a few seconds have shown the skew, the error
depends on the number of the newest samples."""
NEAR_NS = 750_000
"""Shorter round trips are those of a cable."""
BACKLOG_NS = 100_000_000
SPACING_NS, TREE_PACE_NS = 8_000_000, 50_000_000
"""Between two requests of a relay: at first, and once it has long kept the time."""
EASING = 200
"""By then it has watched for so many times as long, so no rate is taken from a small part of that time."""
CALM_NS = 5_000_000_000
"""Thousands may have lost one leader: the next one is asked as if it had been watched for so long."""
LEAST_EXCHANGES = 10
ESTIMATE_EVERY_NS = 1_000_000_000
LEAVE_AT = 1.5
"""A clock that was good enough is so until its error is so many times what was asked for: an estimate of an
error varies by as much from one second to the next."""
AHEAD_NS = 500_000_000
"""A clock is judged by its error so much later: the pictures of a burst that is asked for now come then. Soon
after the first answers the rate is not known well enough for that."""
GAIN, PATIENCE_NS = 0.9, 3_000_000_000
"""An error that does not become smaller by a tenth within so long will not become much smaller."""
LONGEST_TRY_NS = 15_000_000_000
"""No node asks its leader in quick succession for longer."""


class Progress(NamedTuple):
    """How far a node is with estimating its leader's clock."""

    synced: bool
    samples: int
    time_map: TimeMap | None
    good_enough: bool = True
    """Whether the clock is known as well as was asked for."""


class SteadySchedule:
    """Many requests in quick succession, then one each `pace_ns`, on the grid of this node's slot."""

    least_samples, synced_samples = 1, FIRST_SAMPLES
    """With fewer samples the time is not estimated, or the clock does not count as synchronized."""

    def __init__(
        self,
        *,
        first_pace_ns: int = FIRST_PACE_NS,
        easing_paces_ns: tuple[int, ...] = EASING_PACES_NS,
        pace_ns: int = PACE_NS,
        near_ns: int = NEAR_NS,
    ) -> None:
        """After a round trip shorter than `near_ns` the next request is sent at once."""
        self.request_due_ns = self.estimate_due_ns = NEVER_NS
        """When the next are due, in ns of the node's own clock."""
        self.slot = 0.0
        """The part of the leader's pace, 0 to 1, at which this node's requests are due."""
        self.leader_pace_ns = 0
        """Mean time between two requests of a node that the leader can bear; 0 for any."""
        self.time_is_known = False
        """Whether the time was known when the leader began to be asked, and no clock has stepped since."""
        self._first_pace_ns, self._easing_paces_ns, self._pace_ns = first_pace_ns, easing_paces_ns, pace_ns
        self._near_ns = near_ns
        self._grid_ns = 0
        self._samples_when_synced: int | None = None

    def begin(self, now_ns: int) -> None:
        """Ask and estimate, in this node's slot: many may have begun together."""
        pace_ns = max(self._first_pace_ns, self.leader_pace_ns)
        self._grid_ns = self.request_due_ns = self.estimate_due_ns = now_ns + round(self.slot * pace_ns)

    def restart(self, now_ns: int) -> None:
        """Ask as often as at first again: a clock has stepped."""
        self.time_is_known = False

    def request_sent(self, now_ns: int, progress: Progress) -> None:
        """Fix when the next is due: what a late timer has missed is made up for, but never at once."""
        pace_ns, time_map = self._pace(progress), progress.time_map
        grid_ns = max(self._grid_ns + pace_ns, now_ns - BACKLOG_NS)
        if time_map is not None:
            past_ns = time_map.leader_from_local(grid_ns) - round(self.slot * pace_ns)
            grid_ns += pace_ns // 2 - (past_ns + pace_ns // 2) % pace_ns
        self._grid_ns = grid_ns
        self.request_due_ns = max(grid_ns, now_ns + pace_ns // 2)

    def reply_arrived(self, now_ns: int, round_trip_ns: int, progress: Progress) -> bool:
        """Whether the link is so short that the next request, if it is near, goes out at once.

        A machine that is awake sends as quickly as the leader, one that just woke up is microseconds slower,
        and on a link as short as this they count.
        """
        if not progress.synced and progress.samples == FIRST_SAMPLES - 1:
            self.estimate_due_ns = now_ns
        return round_trip_ns < self._near_ns and self.request_due_ns <= now_ns + self._pace(progress)

    def estimated(self, now_ns: int) -> None:
        """The next estimate is a tenth of a second later."""
        self.estimate_due_ns = now_ns + 100_000_000

    def _pace(self, progress: Progress) -> int:
        if not progress.synced:
            self._samples_when_synced = None
            # Thousands may have lost one leader: there is no hurry.
            is_calm = self.time_is_known and self.leader_pace_ns > 0
            return max(self._pace_ns if is_calm else self._first_pace_ns, self.leader_pace_ns)
        if self._samples_when_synced is None:
            self._samples_when_synced = progress.samples
        easing_ns = self._easing_paces_ns
        stage = (progress.samples - self._samples_when_synced) // EASING_SAMPLES
        if not progress.good_enough:
            # Not as quickly as at first: several such nodes on one radio channel would make it worse.
            stage = min(stage, len(easing_ns) - 1)
        easing = min(self._pace_ns, easing_ns[stage]) if 0 <= stage < len(easing_ns) else self._pace_ns
        return max(easing, self.leader_pace_ns)


class TreeSchedule(SteadySchedule):
    """Ever fewer requests: a leader of many bears it, and all of them together come evenly."""

    least_samples = synced_samples = LEAST_EXCHANGES

    def __init__(self) -> None:
        super().__init__(first_pace_ns=SPACING_NS, pace_ns=TREE_PACE_NS)
        self._began_ns = 0

    def begin(self, now_ns: int) -> None:
        """Ask in quick succession first, but where the time is known as after some seconds."""
        super().begin(now_ns)
        self._began_ns = max(self._began_ns, now_ns - CALM_NS) if self.time_is_known else now_ns

    def restart(self, now_ns: int) -> None:
        """Ask as if for the first time."""
        super().restart(now_ns)
        self.begin(now_ns)

    def estimated(self, now_ns: int) -> None:
        """The next estimate is some requests later."""
        self.estimate_due_ns = now_ns + max(ESTIMATE_EVERY_NS, LEAST_EXCHANGES * self._pace())

    def _pace(self, progress: Progress | None = None) -> int:
        eased_ns = max(self._first_pace_ns, (self._grid_ns - self._began_ns) // EASING)
        return min(eased_ns, max(self._pace_ns, self.leader_pace_ns))


class AccuracyTarget:
    """Compares the 95 % error of a clock with what was asked for; times in ns, `now_ns` the node's own."""

    def __init__(self, wanted_ns: float | None = None) -> None:
        """Without `wanted_ns` every clock is good enough.

        A camera's may take all of its tolerance: the phase is held to that by the clock, so a picture is off
        by both, and its record says by how much each.
        """
        self.wanted_ns = wanted_ns
        self.met = wanted_ns is None
        """Whether the clock is good enough."""
        self.error_ns: float | None = None
        """The 95 % error by which it was judged last."""
        self._least_ns: float | None = None
        self._began_ns = self._gained_ns = 0

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
        over = now_ns - self._gained_ns >= PATIENCE_NS or now_ns - self._began_ns >= LONGEST_TRY_NS
        return self.met or over
