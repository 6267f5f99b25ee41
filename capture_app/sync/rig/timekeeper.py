"""A client's hold of its leader's time: requests in its slot, at the leader's pace, and the newest map."""

from collections import deque

from msgspec.structs import replace

from capture_app.sync.clock.clock_filter import ClockFilter
from capture_app.sync.clock.clock_sample import ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.reference_broadcast.listener import Listener
from capture_app.sync.rig.events import ClockAgreed, ClockAlone, ClockStepped, ClockSynced
from capture_app.sync.wire.beacon import Heard
from capture_app.sync.wire.messages import (
    HeartbeatAck,
    NodeState,
    Report,
    TimeReply,
    Welcome,
    request_at,
    request_before_t0,
)


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


_MS = 1_000_000
_AT_ONCE_NS = -(2**62)
FIRST_SAMPLES = 300
"""K of the paper: samples taken in quick succession before the clock counts as synchronized."""
FIRST_PACE_NS = 3 * _MS
PACE_NS = 25 * _MS
EASING_PACES_NS, EASING_SAMPLES = (6 * _MS, 12 * _MS), 200
"""Between the two, so many samples at each of these: until a few seconds have shown the skew, the time is
only as good as the newest samples are many."""
NEAR_NS = 750_000
"""Shorter round trips are those of a wire."""
BACKLOG_NS = 100 * _MS
OUTSTANDING = 512
MAP_EVERY_NS = 100 * _MS


ClockEvent = ClockStepped | ClockSynced | ClockAgreed | ClockAlone


class Timekeeper:
    """The time of the leader that is followed; `now_ns` is always the node's own clock.

    Its map outlives a leader that fell silent, until `forget`.
    """

    def __init__(self, first_sequence: int) -> None:
        self.clock = ClockFilter()
        self.listener = Listener()
        self.own_map: TimeMap | None = None
        """What the exchanges alone tell of the leader's clock, before anything was agreed with others."""
        self.time_map: TimeMap | None = None
        """The newest estimate of the leader's clock, the root's where the leader is a relay."""
        self.synced = False
        self._holding = False
        """Whether the map is one of before, of another way to the same root."""
        self._client = 0
        self._slot = 0.0
        self._told_pace_ns = 0
        self._onward: TimeMap | None = None
        """Where the leader is a relay: from its clock to the root's."""
        self._sequence = first_sequence
        self._outstanding: dict[int, int] = {}
        self._request: bytes | None = None
        self._grid_ns = 0
        self._request_due_ns = self._map_due_ns = _AT_ONCE_NS
        self._events: deque[ClockEvent] = deque()

    # In

    @property
    def knows(self) -> bool:
        """Whether the time can be told: by the leader's answers, or held over from the one before."""
        return self.synced or (self._holding and self.time_map is not None)

    def forget(self, *, same_root: bool = False) -> None:
        """Another leader has another clock; below the same root the map is held over until it is known."""
        self._holding = same_root and self.knows
        self.clock.reset()
        self.listener.forget()
        self.own_map = None
        if not self._holding:
            self.time_map = None

    def follow(self, welcome: Welcome, now_ns: int) -> None:
        """Begin to ask a leader that has taken this client in."""
        self.synced = False
        self._client, self._slot = welcome.client, welcome.slot
        self._outstanding = {}
        self.take_terms(welcome)
        self._grid_ns = self._request_due_ns = self._map_due_ns = now_ns

    def take_terms(self, message: Welcome | HeartbeatAck) -> None:
        """Note the pace that the leader bears, and where its clock stands to the root's."""
        self._told_pace_ns = message.pace_ns
        self._onward = message.onward.time_map() if message.onward else None

    def stop(self) -> None:
        """Ask no more: the leader is gone."""
        self._request = None

    def take_reply(self, reply: TimeReply, now_ns: int) -> bool:
        """Take in a reply that arrived at `now_ns`; False if it answers nothing that was asked."""
        t0_ns = self._outstanding.pop(reply.sequence, None)
        if t0_ns is None or t0_ns != reply.t0_ns:
            return False
        sample = ClockSample(t0_ns, reply.t1_ns, reply.t2_ns, now_ns)
        if sample.round_trip_ns < NEAR_NS and self._request_due_ns <= now_ns + self._pace_ns:
            # The next one is sent at once: a machine that is awake sends as quickly as the leader, one
            # that just woke up is microseconds slower, and on a link as short as this they count.
            self._prepare_request(now_ns)
        if not self.clock.add(sample):
            self.synced = self._holding = False
            self.listener.forget()
            self.time_map = self.own_map = None
            self._events.append(ClockStepped())
        if not self.synced and self.clock.samples >= FIRST_SAMPLES:
            self._update_map(now_ns)
        return True

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due."""
        if now_ns >= self._map_due_ns:
            self._update_map(now_ns)
        if now_ns >= self._request_due_ns:
            self._prepare_request(now_ns)

    # Out

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` wants to be called."""
        due_ns = min(self._map_due_ns, self._request_due_ns)
        tell_due_ns = self.listener.next_timer() if self.synced else None
        return due_ns if tell_due_ns is None else min(due_ns, tell_due_ns)

    def heard(self, now_ns: int) -> Heard | None:
        """Return what is to be told now of the beacons that were heard, None where nothing is due."""
        if not self.synced or self.own_map is None:
            return None
        return self.listener.tell(self._client, self.own_map, now_ns)

    def request_to_send(self, now_ns: int) -> bytes | None:
        """Return the request that is due, None where none is; it carries `now_ns`, so send it at once."""
        if self._request is None:
            return None
        request, self._request = request_at(self._request, now_ns), None
        self._outstanding[self._sequence] = now_ns
        if len(self._outstanding) > OUTSTANDING:
            del self._outstanding[next(iter(self._outstanding))]
        return request

    def report(self, state: NodeState, message: str, now_ns: int) -> Report:
        """Return a report of this node's time, with what was agreed with others."""
        report = time_report(state, message, self.time_map, self.clock.samples, now_ns)
        correction = self.listener.correction
        if correction is None:
            return report
        return replace(
            report,
            moved_ns=correction.reference_correction_ns,
            apart_ns=round(correction.relative_uncertainty_ns),
        )

    def next_event(self) -> ClockEvent | None:
        """Return the next thing that happened, None where there is none."""
        return self._events.popleft() if self._events else None

    # The parts

    @property
    def _pace_ns(self) -> int:
        if not self.synced:
            return FIRST_PACE_NS
        if self._told_pace_ns > PACE_NS:
            return self._told_pace_ns
        stage = max(0, self.clock.samples - FIRST_SAMPLES) // EASING_SAMPLES
        return min(PACE_NS, EASING_PACES_NS[stage]) if stage < len(EASING_PACES_NS) else PACE_NS

    def _prepare_request(self, now_ns: int) -> None:
        """Prepare a request, and set when the next is due: on the grid of this client's slot.

        What a late timer has missed is made up for, but never in a burst.
        """
        pace_ns = self._pace_ns
        grid_ns = max(self._grid_ns + pace_ns, now_ns - BACKLOG_NS)
        if self.time_map is not None:
            past_ns = self.time_map.leader_from_local(grid_ns) - round(self._slot * pace_ns)
            grid_ns += pace_ns // 2 - (past_ns + pace_ns // 2) % pace_ns
        self._grid_ns = grid_ns
        self._request_due_ns = max(grid_ns, now_ns + pace_ns // 2)
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        self._request = request_before_t0(self._client, self._sequence)

    def _update_map(self, now_ns: int) -> None:
        self._map_due_ns = now_ns + MAP_EVERY_NS
        time_map = self.clock.time_map(now_ns)
        if time_map is None:
            return
        self.own_map = time_map
        if self._holding and self.clock.samples < FIRST_SAMPLES:
            return
        self._holding = False
        agreed_before = self.listener.correction is not None
        time_map = self.listener.corrected(time_map, now_ns)
        correction = self.listener.correction
        if correction is not None and not agreed_before:
            self._events.append(ClockAgreed(round(correction.relative_uncertainty_ns)))
        elif correction is None and agreed_before:
            self._events.append(ClockAlone())
        if self._onward is not None:
            time_map = time_map.chained_to(self._onward)
        self.time_map = time_map
        if not self.synced and self.clock.samples >= FIRST_SAMPLES:
            self.synced = True
            self._events.append(ClockSynced(time_map))
