"""What phones with the app say and are told, and the clock of one of them.

The apps are libsoftwaresync and RecSync, from google-research/libsoftwaresync at 028709a. Calls are a
big-endian 32-bit method and a text that ends with the datagram; time messages are big-endian 64-bit times in
ns. Both go to a fixed port, whatever port was sent from. Nothing is sealed or numbered, and only heartbeats
are acknowledged.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.timekeeping.poll_schedule import FIRST_SAMPLES, AccuracyTarget, Progress, SteadySchedule

CALL_PORT, TIME_PORT = 8244, 9428
HEARTBEAT_EVERY_NS = 1_000_000_000
TIME_REQUEST, TIME_ANSWER = struct.Struct(">q"), struct.Struct(">qqq")
_METHOD = struct.Struct(">i")
MOST_BYTES = 1024

PERIOD_NS, GOAL_PHASE_NS, ALIGNED_NS = 33_320_000, 15_000_000, 100_000
"""The app's own constants (for a Pixel 3): leader time % period is to be at the goal, aligned to so much."""
KNOCK_EVERY_NS = 100_000_000
"""Until a phone has answered once it is asked no quicker: forged heartbeats must aim no flood at anybody."""
OUTSTANDING = 512
ACCURATE_NS = 50_000.0
"""A phone is told the time when it is known to this 95 % error, or will hardly be known better. With twice
that 3 of 16 phones were up to 214 us off in their first minute, with this none over 43 (simulated link)."""
STILL_EVERY_NS = 500_000_000
"""The app keeps one trigger at a time, and saves a picture before the next: it takes none in between."""
AGAIN_EVERY_NS, LAST_CALL_NS = 100_000_000, 100_000_000
"""A trigger is repeated, as nothing acknowledges it, but not near its time: it would be obeyed twice."""
QUIET_BEFORE_NS, QUIET_AFTER_NS = 3_000_000_000, 1_000_000_000
"""Phones do not move their phase so long before a picture, and after it: it takes five long frames, 2 s."""


class Method(IntEnum):
    """What a call asks for."""

    HEARTBEAT = 1
    """A phone is here: name, IPv4 address, and true or false for having the time, with commas between."""
    HEARTBEAT_ACK = 2
    OFFSET_UPDATE = 3
    """Leader time is the phone's time minus this, decimal, in ns."""
    SET_TRIGGER_TIME = 200_000
    """Save the first frame at or after this leader time, decimal, in ns; a later call replaces it."""
    DO_PHASE_ALIGN = 200_001
    SET_EXPOSURE = 200_002
    """Exposure in ns and ISO, with a comma between."""
    START_RECORDING = 200_003
    """RecSync's, as the next; libsoftwaresync ignores both."""
    STOP_RECORDING = 200_004


def encode_call(method: Method, text: str = "") -> bytes:
    """Return the datagram of a call."""
    return _METHOD.pack(method) + text.encode()


def decode_call(data: bytes) -> tuple[int, str] | None:
    """Return method and text of a call; None for a datagram that is none."""
    if not _METHOD.size <= len(data) <= MOST_BYTES:
        return None
    return _METHOD.unpack_from(data)[0], data[_METHOD.size :].decode("utf-8", "replace")


def heartbeat_name(text: str) -> str | None:
    """The phone's name by the text of a heartbeat; None where it is the text of none.

    Its address may be another network's, and last it says whether it has the time.
    """
    parts = text.rsplit(",", 2)
    if len(parts) != 3 or parts[2] not in ("true", "false"):
        return None
    return parts[0]


class AppPhone:
    """One phone; all times are the leader's clock, in ns.

    The leader asks here, and the phone answers: the map goes from the leader's clock to the phone's.
    """

    def __init__(self, name: str, host: str, now_ns: int) -> None:
        self.name, self.host = name, host
        self.last_heard_ns = now_ns
        self.lost = False
        self.synced = False
        """Whether its clock is known well enough to be told."""
        self.time_map: TimeMap | None = None
        self.tell_due_ns: int | None = None
        """When it is next told its offset; None before the first time."""
        self.align_due_ns = now_ns
        self._clock, self._target = ClockFilter(), AccuracyTarget(ACCURATE_NS)
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
                self.synced = self._target.judge(self.time_map, now_ns) or self.synced
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
            self._target.restart()
            self._schedule.begin(t3_ns)

    def pace(self, pace_ns: int) -> None:
        """Ask no more often than this, in ns, once the clock is known."""
        self._schedule.leader_pace_ns = pace_ns

    @property
    def _request_due_ns(self) -> int:
        return self._schedule.request_due_ns if self._knock_due_ns is None else self._knock_due_ns

    @property
    def _progress(self) -> Progress:
        return Progress(self.synced, self.samples, self.time_map, self._target.met)

    def _prepare_request(self, now_ns: int) -> None:
        self._is_request_due = True
        if self._knock_due_ns is not None:
            self._knock_due_ns = now_ns + KNOCK_EVERY_NS
        else:
            self._schedule.request_sent(now_ns, self._progress)


@dataclass(slots=True)
class _Still:
    """A picture to come: its instant, and when its trigger is sent, first and next; leader time in ns."""

    instant_ns: int
    trigger_ns: int
    due_ns: int


class AppOrders:
    """The orders of all phones; `now_ns` is leader time."""

    def __init__(self) -> None:
        self.is_recording = False
        self._stills: list[_Still] = []
        self._quiet_until_ns = 0

    def add_stills(self, instants_ns: Sequence[int], period_ns: int, now_ns: int) -> tuple[int, ...]:
        """Order a picture at each of these instants that the app can take, and return those.

        The trigger goes to half a period before, so that the first frame after it is the nearest one.
        """
        taken: list[int] = []
        for instant_ns in instants_ns:
            before_ns = self._stills[-1].instant_ns if self._stills else None
            trigger_ns = instant_ns - period_ns // 2
            if trigger_ns <= now_ns or (before_ns is not None and instant_ns < before_ns + STILL_EVERY_NS):
                continue
            due_ns = now_ns if before_ns is None else max(now_ns, before_ns + STILL_EVERY_NS // 2)
            self._stills.append(_Still(instant_ns, trigger_ns, due_ns))
            taken.append(instant_ns)
        return tuple(taken)

    def triggers_due(self, now_ns: int) -> list[int]:
        """Return the triggers that are to be sent now, in leader time in ns."""
        due = []
        for still in self._stills:
            if now_ns >= still.due_ns and now_ns < still.trigger_ns:
                due.append(still.trigger_ns)
                still.due_ns = now_ns + AGAIN_EVERY_NS
                if still.due_ns > still.trigger_ns - LAST_CALL_NS:
                    still.due_ns = still.instant_ns
        for still in self._stills:
            if now_ns >= still.instant_ns:
                self._quiet_until_ns = max(self._quiet_until_ns, still.instant_ns + QUIET_AFTER_NS)
        self._stills = [still for still in self._stills if now_ns < still.instant_ns]
        return due

    def may_align(self, now_ns: int) -> bool:
        """Whether no picture or recording is near."""
        if self.is_recording or now_ns < self._quiet_until_ns:
            return False
        return all(still.instant_ns > now_ns + QUIET_BEFORE_NS for still in self._stills)

    def next_timer(self) -> int | None:
        """Leader time in ns at which a trigger is due, None for never."""
        return min((still.due_ns for still in self._stills), default=None)
