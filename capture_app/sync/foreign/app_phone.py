"""The leader's knowledge of one phone with the app: when it was heard, and its clock."""

from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.timekeeping.accuracy_goal import AccuracyGoal
from capture_app.sync.timekeeping.poll_schedule import FIRST_SAMPLES, Progress, SteadySchedule

KNOCK_EVERY_NS = 100_000_000
"""Until a phone has answered once it is asked no quicker: forged heartbeats must aim no flood at anybody."""
OUTSTANDING = 512
ACCURATE_NS = 50_000.0
"""A phone is told the time when it is known to this 95 % error, or will hardly be known better. With twice
that 3 of 16 phones were up to 214 us off in their first minute, with this none over 43 (simulated link)."""


class AppPhone:
    """One phone; all times are the leader's clock, in ns.

    The leader asks here, and the phone answers: the map goes from the leader's clock to the phone's.
    """

    def __init__(self, name: str, host: str, now_ns: int) -> None:
        self.name, self.host = name, host
        self.last_heard_ns = now_ns
        self.says_synced = False
        """Whether the phone itself says that it has the time."""
        self.lost = False
        self.synced = False
        """Whether its clock is known well enough to be told."""
        self.time_map: TimeMap | None = None
        self.tell_due_ns: int | None = None
        """When it is next told its offset; None before the first time."""
        self.align_due_ns = now_ns
        self._clock, self._goal = ClockFilter(), AccuracyGoal(ACCURATE_NS)
        self._schedule = SteadySchedule()
        self._schedule.begin(now_ns)
        self._knock_due_ns: int | None = now_ns
        self._outstanding: dict[int, None] = {}
        self._is_request_due = False

    @property
    def samples(self) -> int:
        """Exchanges by which its clock is known."""
        return self._clock.samples

    def next_timer(self) -> int:
        """When `handle_timer` wants to be called."""
        return min(self._request_due_ns, self._schedule.estimate_due_ns)

    def handle_timer(self, now_ns: int) -> None:
        """Estimate the phone's clock, and prepare a request, where they are due."""
        if now_ns >= self._schedule.estimate_due_ns:
            self._schedule.estimated(now_ns)
            self.time_map = self._clock.time_map(now_ns)
            if self.time_map is not None and self.samples >= FIRST_SAMPLES:
                self.synced = self._goal.judge(self.time_map, now_ns) or self.synced
        if now_ns >= self._request_due_ns:
            self._prepare_request(now_ns)

    def take_request(self, now_ns: int) -> bool:
        """Whether a request is to be sent at `now_ns`; it is then outstanding."""
        if not self._is_request_due:
            return False
        self._is_request_due = False
        self._outstanding[now_ns] = None
        if len(self._outstanding) > OUTSTANDING:
            del self._outstanding[next(iter(self._outstanding))]
        return True

    def take_answer(self, t0_ns: int, t1_ns: int, t2_ns: int, t3_ns: int) -> None:
        """Take in an answer: t0 and t3 by the leader's clock, t1 and t2 by the phone's; in ns."""
        if t0_ns not in self._outstanding:
            return
        del self._outstanding[t0_ns]
        if self._knock_due_ns is not None:
            self._knock_due_ns = None
            self._schedule.begin(t3_ns)
        sample = ClockSample(t0_ns, t1_ns, t2_ns, t3_ns)
        if self._schedule.reply_arrived(t3_ns, sample.round_trip_ns, self._progress):
            self._prepare_request(t3_ns)
        if not self._clock.add(sample):
            self.synced, self.time_map, self.tell_due_ns = False, None, None
            self._goal.restart()
            self._schedule.begin(t3_ns)

    def pace(self, pace_ns: int) -> None:
        """Ask no more often than this, in ns, once the clock is known."""
        self._schedule.leader_pace_ns = pace_ns

    @property
    def _request_due_ns(self) -> int:
        return self._schedule.request_due_ns if self._knock_due_ns is None else self._knock_due_ns

    @property
    def _progress(self) -> Progress:
        return Progress(self.synced, self.samples, self.time_map, self._goal.met)

    def _prepare_request(self, now_ns: int) -> None:
        self._is_request_due = True
        if self._knock_due_ns is not None:
            self._knock_due_ns = now_ns + KNOCK_EVERY_NS
        else:
            self._schedule.request_sent(now_ns, self._progress)
