"""Timekeeping on a node: time requests on a schedule, and the newest time map to the leader's clock."""

from collections import deque
from collections.abc import MutableSequence
from math import sqrt

from msgspec.structs import replace

from capture_app.common.bounds import CENTURY_NS, MAX_COUNT, MAX_TEXT, sendable
from capture_app.common.node_state import NodeState
from capture_app.sync.clock.clock_changes import ClockState
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.likely_line import STAMP_NS
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.timekeeping.clock_events import (
    ClockChanged,
    ClockEvent,
    ClockSynced,
    StepRefused,
)
from capture_app.sync.timekeeping.map_history import MapHistory
from capture_app.sync.timekeeping.poll_schedule import (
    AT_ONCE_NS,
    AccuracyTarget,
    Progress,
    SteadySchedule,
)
from capture_app.sync.timekeeping.rates import RateWatch
from capture_app.sync.wire.codec import request_at, request_before_t0
from capture_app.sync.wire.datagrams import Report, RigConfigMessage, TimeReply

OUTSTANDING = 512
"""Maximum number of unanswered requests that are remembered: those of 1.5 s at the first interval.

A silent leader counts as lost after as long.
"""
STEP_REPORT_INTERVAL_NS = 10_000_000_000
"""Minimum interval between two reports of refused steps, so that forged messages cannot flood the log."""
MAX_EVENTS = 256
"""Maximum number of events stored for a node that does not read them."""
CONTRADICTED = 0.05
"""A sample contradicts an estimate if it leaves its minimum round trip this part smaller."""


class Timekeeper:
    """Estimator of the followed leader's clock; `now_ns` is always the node's own clock.

    Without a leader the newest map stays in use (holdover). Another leader's estimate replaces it as soon as
    that is better. A leader under another root replaces it at once.
    """

    def __init__(
        self,
        first_sequence: int,
        schedule: SteadySchedule | None = None,
        *,
        clock: ClockFilter | None = None,
        target: AccuracyTarget | None = None,
        samples: MutableSequence[ClockSample] | None = None,
    ) -> None:
        """`target` is the requested clock accuracy; every answered exchange is added to `samples`."""
        self.clock = clock or ClockFilter()
        self.target = target or AccuracyTarget()
        self.rate = RateWatch()
        self.schedule = schedule or SteadySchedule()
        self.map_to_leader: TimeMap | None = None
        """Newest map to the clock of the leader that answers the requests, even if that is a relay."""
        self.time_map: TimeMap | None = None
        """Newest map to the root's clock; the leader is the root unless it is a relay."""
        self.path: tuple[int, ...] = ()
        """Instances from the root to the leader whose answers made `time_map`."""
        self.synced = False
        """Whether the present leader's clock is known as accurately as requested, or as its link allows."""
        self.time_is_known = False
        """Whether `time_map` is reliable, from the leader's answers or in holdover."""
        self.requests = 0
        """Number of time requests sent."""
        self._samples = samples
        self._number = 0
        self._asked: RigConfigMessage | None = None
        """Configuration of the leader that is asked, or was last; `clock` estimates that leader's clock."""
        self._sequence = first_sequence
        self.outstanding: dict[int, int] = {}
        """Send times of unanswered requests by sequence number, lost ones included; at most OUTSTANDING."""
        self._request: bytes | None = None
        self._history = MapHistory()
        self._agreed_ns = 0
        """Local time of the newest sample that agreed with those before."""
        self._right_until_ns: int | None = None
        """That time at the last step of a clock, until the time is known again."""
        self._stepped = False
        """Whether a clock has stepped or been slewed, and the time is not known again yet."""
        self._reported_steps, self._report_steps_ns = 0, AT_ONCE_NS
        self.events: deque[ClockEvent] = deque(maxlen=MAX_EVENTS)
        """Events for the caller to take, who may add others."""

    # In

    def follow(self, config: RigConfigMessage, number: int, slot: float, now_ns: int) -> None:
        """Start asking a leader that has admitted this node. The time map of the same root stays in use.

        If the leader continues the time of an earlier root, the map to that root stays in use too. Its
        uncertainty then grows by the uncertainty that the leader states.
        """
        if self._asked is None or config.leader != self._asked.leader:
            self.clock.reset()
            self.map_to_leader = None
        if self.time_is_known and self.time_map is not None and config.path[0] != self.path[0]:
            continued = config.continues
            if continued is not None and continued.is_finite and continued.path[0] == self.path[0]:
                self.time_map = self.time_map.chained_to(continued.time_map())
                self.path = (config.path[0], *(self.path[1:] or self.path))
        if not self.time_is_known or config.path[0] != self.path[0]:
            self.time_map, self.time_is_known = None, False
            self._history.clear()
        self.synced = False
        self.target.restart()
        self.rate.restart()
        self._number = number
        self.outstanding = {}
        self._request = None
        self.schedule.slot = slot
        self.update_config(config)
        self.schedule.time_is_known = self.time_is_known
        self.schedule.begin(now_ns)

    def update_config(self, config: RigConfigMessage) -> None:
        """Store the leader's present configuration."""
        self._asked = config
        self.schedule.leader_interval_ns = config.poll_interval_ns
        self.clock.look_back(config.poll_interval_ns)

    def stop(self) -> None:
        """Stop sending requests: the leader is lost."""
        self._request = None

    def forget(self) -> None:
        """Discard the time map, and what is known of the leader's clock."""
        self.time_map, self.time_is_known, self._asked = None, False, None

    def take_reply(self, reply: TimeReply, now_ns: int) -> bool:
        """Process a reply that arrived at `now_ns`. Return False if it matches no outstanding request."""
        t0_ns = self.outstanding.pop(reply.sequence, None)
        if t0_ns is None or t0_ns != reply.t0_ns:
            return False
        sample = ClockSample(t0_ns, reply.t1_ns, reply.t2_ns, now_ns)
        if self._samples is not None:
            self._samples.append(sample)
        if self.schedule.reply_arrived(now_ns, sample.round_trip_ns, self._progress):
            self._prepare_request(now_ns)
        samples = self.clock.samples
        if self.clock.add(sample):
            self._agreed_ns = now_ns if self.clock.samples > samples else self._agreed_ns
            if self.map_to_leader is not None and is_contradicted(self.map_to_leader, sample):
                self.schedule.contradicted(now_ns)
        else:
            self._right_until_ns = self._right_until_ns or self._agreed_ns
            self.synced = self.time_is_known = False
            self.target.restart()
            self.rate.restart()
            self.time_map = self.map_to_leader = None
            self.schedule.restart(now_ns)
            if not self._stepped:
                self.events.append(ClockChanged(jumped=True))
            self._stepped = True
        if self.clock.refused_steps > self._reported_steps and now_ns >= self._report_steps_ns:
            self.events.append(StepRefused(self.clock.refused_steps - self._reported_steps))
            self._reported_steps, self._report_steps_ns = (
                self.clock.refused_steps,
                now_ns + STEP_REPORT_INTERVAL_NS,
            )
        return True

    def handle_timer(self, now_ns: int) -> None:
        """Estimate the clock and prepare the next time request, each if it is due."""
        if now_ns >= self.schedule.estimate_due_ns:
            self._estimate(now_ns)
        if now_ns >= self.schedule.request_due_ns:
            self._prepare_request(now_ns)

    # Out

    def next_timer(self) -> int:
        """Return the local time in ns at which `handle_timer` is to be called."""
        return min(self.schedule.estimate_due_ns, self.schedule.request_due_ns)

    def request_to_send(self, now_ns: int) -> bytes | None:
        """Return the request that is due, or None; it carries `now_ns`, so send it at once."""
        if self._request is None:
            return None
        request, self._request = request_at(self._request, now_ns), None
        self.requests += 1
        self.outstanding[self._sequence] = now_ns
        if len(self.outstanding) > OUTSTANDING:
            del self.outstanding[next(iter(self.outstanding))]
        return request

    def report(self, state: NodeState, message: str, now_ns: int) -> Report:
        """Return a report of this node's time, without the camera's fields."""
        report = Report(
            state=state,
            message=message[:MAX_TEXT],
            samples=self.clock.samples,
        )
        if (time_map := self.time_map) is None:
            return report
        return replace(
            report,
            offset_ns=sendable(time_map.leader_from_local(now_ns) - now_ns, CENTURY_NS),
            skew_ppm=time_map.skew * 1e6,
            uncertainty_ns=sendable(time_map.uncertainty_at(now_ns)),
            hard_bound_ns=sendable(time_map.hard_bound_at(now_ns)),
            round_trip_ns=time_map.round_trip_ns,
        )

    # The parts

    @property
    def _progress(self) -> Progress:
        return Progress(self.synced, self.clock.samples, self.time_map, self.target.met)

    def _prepare_request(self, now_ns: int) -> None:
        self.schedule.request_sent(now_ns, self._progress)
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        self._request = request_before_t0(self._number, self._sequence)

    def _estimate(self, now_ns: int) -> None:
        own, asked = self.clock.time_map(now_ns), self._asked
        clock = self.clock.changes
        is_settled = self.synced and self.target.met and clock.state is ClockState.STEADY
        self.schedule.estimated(now_ns, is_settled=is_settled)
        if own is None or asked is None:
            return
        self.map_to_leader = own
        if self.clock.samples < self.schedule.min_samples:
            return
        self._stepped = False
        time_map = asked.root_map(own)
        largest_ns = max(abs(own.offset_ns), abs(time_map.offset_ns))
        if largest_ns > CENTURY_NS or time_map.hard_bound_ns > MAX_COUNT:
            # No report, relay or session can carry it.
            return
        above_ns = sqrt(max(0.0, time_map.uncertainty_ns**2 - own.uncertainty_ns**2))
        until_ns = self.schedule.estimate_due_ns
        held = self.time_map if self.time_is_known and self.path[-1] != asked.leader else None
        if held is not None and held.uncertainty_at(until_ns) < time_map.uncertainty_at(until_ns):
            # The previous leader's map is still the more certain one, thanks to its better skew.
            time_map = held
        else:
            self.time_map, self.path, self.time_is_known = time_map, asked.path, True
            event = self.rate.judge(time_map, clock.rate_changed_ns)
            if event is not None:
                self.events.append(event)
            is_changed = isinstance(event, ClockChanged)
            doubted = self._history.doubt(
                time_map, now_ns, after_ns=self._right_until_ns, is_changed=is_changed
            )
            if doubted is not None:
                self.events.append(doubted)
            self._right_until_ns = None
            self._history.add(time_map, now_ns)
        if (
            self.target.judge(time_map, now_ns, above_ns, is_back=clock.state is ClockState.RESTORED)
            and not self.synced
        ):
            self.synced = True
            self.events.append(ClockSynced(time_map))


def is_contradicted(time_map: TimeMap, sample: ClockSample) -> bool:
    """Return whether a map's minimum round trip is too large for a later sample, as after a change."""
    room_ns = (0.5 - CONTRADICTED) * time_map.round_trip_ns
    early_ns = time_map.leader_from_local(sample.t0_ns) + room_ns - sample.t1_ns
    late_ns = sample.t2_ns + room_ns - time_map.leader_from_local(sample.t3_ns)
    return max(early_ns, late_ns) > STAMP_NS
