"""Messages of the phone app, and the leader's clock estimate of one phone.

The apps are libsoftwaresync and RecSync, from google-research/libsoftwaresync at 028709a. A call is a
big-endian 32-bit method number and a text that extends to the end of the datagram. Time messages are
big-endian 64-bit times in ns. Both go to a fixed port, regardless of the source port. Messages are neither
authenticated nor numbered, and only heartbeats are acknowledged.
"""

import re
import struct
from collections import deque
from collections.abc import Sequence
from enum import IntEnum

from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.timekeeping.poll_schedule import MIN_EXCHANGES, AccuracyTarget, Progress, SteadySchedule

CALL_PORT, TIME_PORT = 8244, 9428
HEARTBEAT_EVERY_NS = 1_000_000_000
TIME_REQUEST, TIME_ANSWER = struct.Struct(">q"), struct.Struct(">qqq")
_METHOD = struct.Struct(">i")
MAX_BYTES = 1024

PERIOD_NS, GOAL_PHASE_NS, ALIGNED_NS = 33_320_000, 15_000_000, 100_000
"""Constants of the app (for a Pixel 3): frame period, target of leader time modulo period, and tolerance."""
ACCURATE_NS = 50_000.0
"""Send a phone its offset at this 95 % uncertainty, or once it stops improving. On a simulated link, twice
this value left 3 of 16 phones up to 214 us off in their first minute; this value left none above 43 us."""
STILL_EVERY_NS = 500_000_000
"""Minimum interval between stills: the app holds one trigger, and takes no other until its image is saved."""
AGAIN_EVERY_NS, LAST_CALL_NS = 100_000_000, 100_000_000
"""Interval of trigger repeats, as triggers are not acknowledged; none near its time, as it would fire
twice."""
QUIET_BEFORE_NS, QUIET_AFTER_NS = 3_000_000_000, 1_000_000_000
"""Time before and after a still without phase alignment, which takes five long frames, 2 s."""


class CallMethod(IntEnum):
    """Method number of a call."""

    HEARTBEAT = 1
    """Phone is connected: name, IPv4 address, and true or false for synchronized, separated by commas."""
    HEARTBEAT_ACK = 2
    OFFSET_UPDATE = 3
    """Offset to subtract from the phone's time to get leader time, in ns, decimal."""
    SET_TRIGGER_TIME = 200_000
    """Save the first frame at or after this leader time (ns, decimal); a later call replaces it."""
    DO_PHASE_ALIGN = 200_001
    SET_EXPOSURE = 200_002
    """Exposure in ns and ISO, separated by a comma."""
    START_RECORDING = 200_003
    """RecSync only, like STOP_RECORDING; libsoftwaresync ignores both."""
    STOP_RECORDING = 200_004


def encode_call(method: CallMethod, text: str = "") -> bytes:
    """Return the datagram of a call."""
    return _METHOD.pack(method) + text.encode()


def decode_call(data: bytes) -> tuple[int, str] | None:
    """Return a call's method number and text, or None if the datagram is not a call."""
    if not _METHOD.size <= len(data) <= MAX_BYTES:
        return None
    return _METHOD.unpack_from(data)[0], data[_METHOD.size :].decode("utf-8", "replace")


def heartbeat_name(text: str) -> str | None:
    """Return the phone's name from a heartbeat's text, or None if the text is not a heartbeat.

    The address in the text is ignored: it may belong to another network. The last field is the synchronized
    flag.
    """
    match = re.fullmatch(r"(.*),[^,]*,(?:true|false)", text, re.DOTALL)
    return None if match is None else match[1]


class AppPhone:
    """State of one phone; all times are in the leader's clock, in ns.

    The leader sends the requests and the phone replies, so the time map leads from the leader's clock to the
    phone's.
    """

    def __init__(self, name: str, host: str, now_ns: int) -> None:
        self.name, self.host = name, host
        self.last_heard_ns = now_ns
        self.lost = False
        self.synced = False
        """Whether its clock is known well enough to send its offset."""
        self.time_map: TimeMap | None = None
        self.report_due_ns: int | None = None
        """Time of the next offset update; None before the first one."""
        self.align_due_ns = now_ns
        self._clock, self._target = ClockFilter(), AccuracyTarget(ACCURATE_NS)
        self._schedule = SteadySchedule()
        self._schedule.begin(now_ns)
        self._probe_due_ns: int | None = now_ns
        self._outstanding: deque[int] = deque(maxlen=512)
        self._is_request_due = False

    @property
    def samples(self) -> int:
        """Return the number of clock exchanges behind the estimate."""
        return self._clock.samples

    def next_timer(self) -> int:
        """Return the time (ns) at which `handle_timer` is next due."""
        return min(self._request_due_ns, self._schedule.estimate_due_ns)

    def handle_timer(self, now_ns: int) -> None:
        """Update the clock estimate and prepare a request, where due."""
        if now_ns >= self._schedule.estimate_due_ns:
            self._schedule.estimated(now_ns, is_settled=False)
            self.time_map = self._clock.time_map(now_ns)
            if self.time_map is not None and self.samples >= MIN_EXCHANGES:
                self.synced = self._target.judge(self.time_map, now_ns) or self.synced
        if now_ns >= self._request_due_ns:
            self._prepare_request(now_ns)

    def take_request(self, now_ns: int) -> bool:
        """Return whether to send a request at `now_ns`, and record it as outstanding."""
        is_due, self._is_request_due = self._is_request_due, False
        if is_due:
            self._outstanding.append(now_ns)
        return is_due

    def take_answer(self, t0_ns: int, t1_ns: int, t2_ns: int, t3_ns: int) -> None:
        """Add a reply's timestamps in ns: t0 and t3 in the leader's clock, t1 and t2 in the phone's."""
        if t0_ns not in self._outstanding:
            return
        self._outstanding.remove(t0_ns)
        if self._probe_due_ns is not None:
            self._probe_due_ns = None
            self._schedule.begin(t3_ns)
        sample = ClockSample(t0_ns, t1_ns, t2_ns, t3_ns)
        if self._schedule.reply_arrived(t3_ns, sample.round_trip_ns, self._progress):
            self._prepare_request(t3_ns)
        if not self._clock.add(sample):
            self.synced, self.time_map, self.report_due_ns = False, None, None
            self._target.restart()
            self._schedule.begin(t3_ns)

    def limit_requests(self, poll_interval_ns: int) -> None:
        """Set the minimum request interval (ns) for a phone whose clock is known."""
        self._schedule.leader_interval_ns = poll_interval_ns

    @property
    def _request_due_ns(self) -> int:
        return self._schedule.request_due_ns if self._probe_due_ns is None else self._probe_due_ns

    @property
    def _progress(self) -> Progress:
        return Progress(self.synced, self.samples, self.time_map, self._target.met)

    def _prepare_request(self, now_ns: int) -> None:
        self._is_request_due = True
        if self._probe_due_ns is not None:
            # Forged heartbeats must not cause a flood before a phone's first reply.
            self._probe_due_ns = now_ns + 100_000_000
        else:
            self._schedule.request_sent(now_ns, self._progress)


class AppOrders:
    """Pending stills and recording state of all phones; `now_ns` is leader time."""

    def __init__(self) -> None:
        self.is_recording = False
        self.stills: dict[tuple[int, int], int] = {}
        """Time of each pending still's next trigger message, by its instant and its trigger time (ns)."""
        self._quiet_until_ns = 0

    def add_stills(self, instants_ns: Sequence[int], period_ns: int, now_ns: int) -> tuple[int, ...]:
        """Schedule a still at each instant that the app can serve, and return those instants.

        The trigger time is half a period before the instant, so that the first frame after it is the nearest
        one.
        """
        taken: list[int] = []
        for instant_ns in instants_ns:
            before_ns, _ = next(reversed(self.stills), (now_ns - STILL_EVERY_NS, 0))
            trigger_ns = instant_ns - period_ns // 2
            if trigger_ns > now_ns and instant_ns >= before_ns + STILL_EVERY_NS:
                self.stills[instant_ns, trigger_ns] = max(now_ns, before_ns + STILL_EVERY_NS // 2)
                taken.append(instant_ns)
        return tuple(taken)

    def triggers_due(self, now_ns: int) -> list[int]:
        """Return the trigger times (leader time, ns) to send now."""
        due = [still for still, due_ns in self.stills.items() if due_ns <= now_ns < still[1]]
        for instant_ns, trigger_ns in due:
            again_ns = now_ns + AGAIN_EVERY_NS
            self.stills[instant_ns, trigger_ns] = (
                again_ns if again_ns <= trigger_ns - LAST_CALL_NS else instant_ns
            )
        for still in [still for still in self.stills if now_ns >= still[0]]:
            self._quiet_until_ns = max(self._quiet_until_ns, still[0] + QUIET_AFTER_NS)
            del self.stills[still]
        return [trigger_ns for _, trigger_ns in due]

    def may_align(self, now_ns: int) -> bool:
        """Return whether phones may align: no still is near and no recording runs."""
        return (
            not self.is_recording
            and now_ns >= self._quiet_until_ns
            and all(instant_ns > now_ns + QUIET_BEFORE_NS for instant_ns, _ in self.stills)
        )
