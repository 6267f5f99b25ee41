"""Schedules of a client's time requests: a steady rate for cameras, a decreasing one for relays.

Also the accuracy target of its clock, and whether further quick requests would improve the estimate.
"""

from math import hypot, inf
from typing import NamedTuple

from capture_app.sync.clock.likely_line import ASYMMETRY
from capture_app.sync.clock.time_map import SIGMAS_95, TimeMap

AT_ONCE_NS, NEVER_NS = -(2**62), 2**62
"""Before and after any time of any clock: a local clock may be negative."""
FIRST_SAMPLES = 300
"""K of the paper: samples taken in quick succession, even if the clock is accurate enough before."""
FIRST_INTERVAL_NS, POLL_INTERVAL_NS = 3_000_000, 25_000_000
"""Request interval of the first second, slightly below the paper's 3.43 ms, and the later one, at which a
clock filter's window of 30 s holds 1,200 samples (clock_filter.PACES)."""
EASING_INTERVALS_NS, EASING_SAMPLES = (6_000_000, 12_000_000), 200
"""Intermediate request intervals, and the samples taken at each of them.

The error depends on the number of recent samples until a few seconds have shown the skew.
"""
NEAR_NS, NEAR_INTERVAL_NS = 750_000, 100_000_000
"""Round-trip delays below this are a cable's, and the request interval of a settled clock on it.

Nearly all of its messages are fast, so ten a second show the line. One that contradicts the line brings back
the intervals after synchronization, until the clock is settled again.
"""
BACKLOG_NS = 100_000_000
"""Maximum time that is caught up after a late timer: four requests at POLL_INTERVAL_NS."""
SPACING_NS, TREE_INTERVAL_NS = 8_000_000, 50_000_000
"""Request intervals of a relay: at first, and after it has kept the time for long."""
EASING = 200
"""Ratio of the time since the start to the request interval, so that no rate rests on a short baseline.

As many samples as EASING_SAMPLES are then spread over all of it.
"""
CALM_NS = 5_000_000_000
"""Elapsed time assumed when a second leader is first asked.

Thousands of clients may have lost the first one, and a high initial rate would overload the second.
"""
MIN_EXCHANGES = 10
"""Minimum number of samples for an estimate. Its 95 % bar then held in 90 to 100 % on 15 links, half of which
have bursts of long delays."""
ESTIMATE_EVERY_NS, UNSETTLED_EVERY_NS = 1_000_000_000, 100_000_000
"""Interval of estimates while nothing contradicts the last one, within which drift adds 0.03 us; and until a
clock is as accurate as requested, or after a sample that contradicts the estimate."""
LEAVE_AT = 2.0
"""Factor on the target error at which a good clock stops being good.

On recorded WiFi, the error bars of three cameras varied from 0.7 to 1.64 times the target within two minutes.
With 1.5 all were ready in 87 % of half an hour.
"""
AHEAD_NS = 500_000_000
"""Time ahead at which the clock's error is judged: when the frames of a burst ordered now are taken.

Shortly after the first samples the rate is not known well enough for that.
"""
GAIN, NO_GAIN_TIMEOUT_NS = 0.9, 3_000_000_000
"""An error that does not shrink by a tenth within this time is not expected to shrink much further.

On the paper's link a node that cannot meet its target was told so after 8 s, with a bar of 131 us, and 100
ten seconds later; with 0.8 after 4.9 s and 167 us, with 0.97 after 9.3 s and 112 us (8 trials).
"""
SETTLED_NS = 1_000_000_000
"""An error that meets its link's target will not soon shrink further after so long without gain.

Twice as long after the start, it may still shrink. On the paper's link, messages are faster after the first
second: nodes wait for these.
"""
LINK_MARGIN, MAX_LINK_TARGET_NS = 1.5, 1_000_000
"""What a link can bear: this multiple of the asymmetry's part of the error, as the delays add a tenth to a
third to it (docs/accuracy-measurements.md); and at most half of what restarted cameras are aligned to."""
LONGEST_TRY_NS = 15_000_000_000
"""Maximum time for which a node sends its leader requests in quick succession.

No node reached it on the paper's link and on a recorded one: the last one had gained after 12.6 s (8 trials).
"""


class Progress(NamedTuple):
    """State of a node's estimate of its leader's clock, by which a schedule spaces its requests."""

    synced: bool
    samples: int
    time_map: TimeMap | None
    good_enough: bool = True
    """Whether the clock is as accurate as requested."""


class SteadySchedule:
    """Many requests in quick succession, then one per `poll_interval_ns`, aligned to this node's slot."""

    min_samples = MIN_EXCHANGES
    """Minimum number of samples for an estimate; K in the paper's protocol."""

    def __init__(
        self,
        *,
        first_interval_ns: int = FIRST_INTERVAL_NS,
        easing_intervals_ns: tuple[int, ...] = EASING_INTERVALS_NS,
        poll_interval_ns: int = POLL_INTERVAL_NS,
        near_ns: int = NEAR_NS,
    ) -> None:
        """After a round-trip delay shorter than `near_ns` the next request is sent at once."""
        self.request_due_ns = self.estimate_due_ns = NEVER_NS
        """When the next request and estimate are due, in ns of the node's own clock."""
        self.slot = 0.0
        """Position of this node's requests within the leader's request interval, from 0 to 1."""
        self.leader_interval_ns = 0
        """Minimum mean interval between a node's requests that the leader accepts; 0 for any."""
        self.time_is_known = False
        """Whether the time was known before this leader was first asked, and no clock has stepped since."""
        self._first_interval_ns, self._poll_interval_ns = first_interval_ns, poll_interval_ns
        self._paces_ns = (first_interval_ns, *easing_intervals_ns, poll_interval_ns)
        self._near_ns = near_ns
        self._grid_ns = 0
        self._soonest_ns = NEVER_NS
        self._samples_when_synced: int | None = None
        self._is_near = self._is_settled = False

    def begin(self, now_ns: int) -> None:
        """Start requests and estimates in this node's slot, because many nodes may start together."""
        self._grid_ns = self.request_due_ns = self.estimate_due_ns = now_ns + round(
            self.slot * max(self._first_interval_ns, self.leader_interval_ns)
        )

    def restart(self, now_ns: int) -> None:
        """Return to the initial request rate after a clock has stepped."""
        self.time_is_known = False

    def request_sent(self, now_ns: int, progress: Progress) -> None:
        """Schedule the next request. Time lost to a late timer is caught up gradually."""
        poll_interval_ns, time_map = self._interval(progress), progress.time_map
        grid_ns = max(self._grid_ns + poll_interval_ns, now_ns - BACKLOG_NS)
        if time_map is not None:
            past_ns = time_map.leader_from_local(grid_ns) - round(self.slot * poll_interval_ns)
            grid_ns += poll_interval_ns // 2 - (past_ns + poll_interval_ns // 2) % poll_interval_ns
        self._grid_ns = grid_ns
        self.request_due_ns = max(grid_ns, now_ns + poll_interval_ns // 2)

    def reply_arrived(self, now_ns: int, round_trip_ns: int, progress: Progress) -> bool:
        """Return whether the link is so short that the next request, if it is near, goes out at once.

        A process that is awake sends as quickly as the leader. One that just woke up is microseconds slower,
        which matters on such a short link.
        """
        if not progress.synced and progress.samples == self.min_samples - 1:
            self.estimate_due_ns = now_ns
        self._is_near = round_trip_ns < self._near_ns
        return self._is_near and self.request_due_ns <= now_ns + self._interval(progress)

    def estimated(self, now_ns: int, *, is_settled: bool) -> None:
        """Schedule the next estimate: rarely once the clock `is_settled`, or when a sample contradicts it."""
        self._soonest_ns, self._is_settled = now_ns + UNSETTLED_EVERY_NS, is_settled
        self.estimate_due_ns = now_ns + ESTIMATE_EVERY_NS if is_settled else self._soonest_ns

    def contradicted(self, now_ns: int) -> None:
        """A sample contradicts the newest estimate: make the next one soon, over a cable by many samples."""
        self.estimate_due_ns = min(self.estimate_due_ns, self._soonest_ns)
        if self._is_near and self._is_settled:
            # Once an estimate: else each answer would bring the next request at once.
            self._is_settled, self._samples_when_synced, self.request_due_ns = False, None, now_ns

    def _interval(self, progress: Progress) -> int:
        if not progress.synced:
            self._samples_when_synced = None
            # Thousands of clients may have lost one leader, and the time is known: there is no hurry.
            is_calm = self.time_is_known and self.leader_interval_ns > 0
            return max(
                self._poll_interval_ns if is_calm else self._first_interval_ns, self.leader_interval_ns
            )
        if self._samples_when_synced is None:
            self._samples_when_synced = progress.samples
        stage = 1 + (progress.samples - max(FIRST_SAMPLES, self._samples_when_synced)) // EASING_SAMPLES
        # Slower than the initial rate if it is not good enough: several such nodes would disturb each other.
        last = len(self._paces_ns) - (1 if progress.good_enough else 2)
        interval_ns = min(self._poll_interval_ns, self._paces_ns[max(0, min(stage, last))])
        if self._is_near and self._is_settled and stage > 1:
            interval_ns = max(interval_ns, NEAR_INTERVAL_NS)
        return max(interval_ns, self.leader_interval_ns)


class TreeSchedule(SteadySchedule):
    """Time requests at growing intervals, so that one leader can serve many nodes, at an even load."""

    def __init__(self) -> None:
        super().__init__(first_interval_ns=SPACING_NS, poll_interval_ns=TREE_INTERVAL_NS)
        self._began_ns = 0

    def begin(self, now_ns: int) -> None:
        """Start with requests in quick succession; if the time is known, start at the rate after CALM_NS."""
        super().begin(now_ns)
        self._began_ns = max(self._began_ns, now_ns - CALM_NS) if self.time_is_known else now_ns

    def restart(self, now_ns: int) -> None:
        """Begin again with requests in quick succession, because a clock has stepped."""
        super().restart(now_ns)
        self.begin(now_ns)

    def estimated(self, now_ns: int, *, is_settled: bool) -> None:
        """Schedule the next estimate some requests later."""
        self.estimate_due_ns = now_ns + max(ESTIMATE_EVERY_NS, MIN_EXCHANGES * self._interval())

    def _interval(self, progress: Progress | None = None) -> int:
        eased_ns = max(self._first_interval_ns, (self._grid_ns - self._began_ns) // EASING)
        return min(eased_ns, max(self._poll_interval_ns, self.leader_interval_ns))


class AccuracyTarget:
    """Target for the 95 % error of a clock; times in ns, `now_ns` is the node's own clock."""

    def __init__(self, target_ns: float | None = None, *, min_ns: float | None = None) -> None:
        """With `min_ns` the target is what the link can bear, at least that; with neither, there is none."""
        self.target_ns = target_ns or min_ns
        """The target at present."""
        self._min_ns = min_ns
        self.error_ns: float | None = None
        """95 % error at the last check."""
        self._gained_ns = 0
        self.restart()

    def restart(self) -> None:
        """Start over: the leader is another one, or a clock has stepped."""
        self.met = self.target_ns is None
        """Whether the clock is good enough."""
        self._min_error_ns, self._began_ns = inf, NEVER_NS

    def judge(self, time_map: TimeMap, now_ns: int, above_ns: float = 0.0, *, is_back: bool = False) -> bool:
        """Update from the newest estimate; return whether it is good enough or will hardly improve.

        `above_ns` is the 95 % error of the relay that is followed, which its link bears as well. A clock that
        `is_back` at its rate after a slew is good again as long as it would have stayed so.
        """
        error_ns = self.error_ns = time_map.uncertainty_at(now_ns + AHEAD_NS)
        if self.target_ns is None:
            return True
        self._began_ns = min(self._began_ns, now_ns)
        if error_ns < GAIN * self._min_error_ns:
            self._min_error_ns, self._gained_ns = error_ns, now_ns
        stays_ns = now_ns - self._gained_ns
        if self._min_ns is not None:
            link_ns = LINK_MARGIN * hypot(SIGMAS_95 * ASYMMETRY * time_map.round_trip_ns / 2.0, above_ns)
            self.target_ns = max(self._min_ns, min(link_ns, MAX_LINK_TARGET_NS))
        if self.met:
            self.met = error_ns <= LEAVE_AT * self.target_ns
        else:
            has_settled = stays_ns >= SETTLED_NS or now_ns - self._began_ns >= 2 * SETTLED_NS
            at_ns = self.target_ns if has_settled else self._min_ns or self.target_ns
            self.met = error_ns <= (LEAVE_AT if is_back else 1.0) * at_ns
        return self.met or stays_ns >= NO_GAIN_TIMEOUT_NS or now_ns - self._began_ns >= LONGEST_TRY_NS
