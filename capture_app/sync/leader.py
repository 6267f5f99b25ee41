"""The leader's state machine: take clients in, answer their time requests, order bursts, notice losses."""

import random
import re
from collections import deque
from dataclasses import dataclass, field

from capture_app.errors import BadInputError, IncompleteError
from capture_app.sync.agreement import WEIGHTS, Agreement, Standing
from capture_app.sync.events import (
    BurstAccepted,
    BurstRefused,
    LeaderEvent,
    NodeJoined,
    NodeLost,
    NodeReturned,
)
from capture_app.sync.messages import (
    CLOCK_ONLY,
    CameraDescription,
    Control,
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    Refused,
    Report,
    TimeRequest,
    Trigger,
    TriggerAck,
    Unknown,
    Welcome,
    WireError,
    decode,
    encode,
    reply_at,
    reply_before_t2,
)
from capture_app.sync.onward import Onward
from capture_app.sync.placement import Forecast, calmest
from capture_app.sync.state import NodeState
from capture_app.sync.timebase import MAX_PERIOD_NS, MIN_PERIOD_NS, Goal
from capture_app.sync.trigger import MAX_BURST_NS, MAX_FRAMES, Burst, burst_instants, possible

Address = tuple[str, int]

_MS = 1_000_000
CLIENT_SILENT_NS = 2000 * _MS
CLOCK_SILENT_NS = 150_000 * _MS
"""A node that only keeps the time may speak but once a minute."""
FREE_PACE_NS, SLOWEST_PACE_NS = 25 * _MS, 60_000 * _MS
TRIGGER_LEAD_NS = 500 * _MS
"""A burst that is asked for now begins this much later, so that every client hears of it before."""
TRIGGER_AGAIN_NS = 50 * _MS
TRIGGER_GIVE_UP_NS = 5000 * _MS
AFTER_BURST_NS = 1000 * _MS
"""The goal stays as it is for so long after a burst's last instant, until every client has picked."""
MAX_CLIENTS = 10_000
FEW_CAMERAS, WEIGH_EVERY_NS = 20, _MS // 5
"""The goal of more cameras than a few is weighed so seldom for each of them, not at each heartbeat."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
"""Names become those of folders in a session: nothing that could leave it."""


@dataclass(frozen=True, slots=True)
class LeaderConfig:
    """What a leader is; without `period_ns` the first camera sets the rig's frame period."""

    instance: int
    transfer_port: int
    period_ns: int | None = None
    align_row: float | None = None
    """Share of the height at which a row's middle of exposure is aligned; None for the first row's start."""
    freedom_ns: int = 0
    """A burst that is asked for now may be put off by so much, to where the cameras' frames meet best."""
    exchanges_per_s: float = 1000.0
    """Time requests that all clients together may send: the more there are, the slower is each one's pace."""


@dataclass(frozen=True, slots=True)
class ClientView:
    """A client as the leader sees it; `age_ns` is the time since it was last heard."""

    name: str
    address: Address
    camera: CameraDescription
    report: Report
    age_ns: int


@dataclass(slots=True)
class _Member:
    """A client that is or was here, lost or alive."""

    name: str
    instance: int
    number: int
    address: Address
    camera: CameraDescription
    report: Report
    heard_ns: int
    slot: float
    lost: str = ""


@dataclass(slots=True)
class _Order:
    """A trigger that a client has not answered yet."""

    member: _Member
    trigger: Trigger
    give_up_ns: int
    due_ns: int = field(default=0)


def spread(index: int) -> float:
    """Return a part of 1 that is far from those of all indices near it (van der Corput 1935)."""
    part, step = 0.0, 0.5
    while index:
        part += step * (index & 1)
        index, step = index >> 1, step / 2.0
    return part


class Leader:
    """The leader's side of the protocol; `now_ns` is the leader's clock, which is the rig's time."""

    def __init__(self, config: LeaderConfig, rng: random.Random) -> None:
        self.config = config
        self.agreement: Agreement | None = None
        self.malformed = 0
        self._rng = rng
        self._members: dict[str, _Member] = {}
        self._bound: dict[str, _Member] = {}
        """Those that do not move to any goal: the goal is moved to suit them."""
        self._by_number: dict[int, _Member] = {}
        self._orders: list[_Order] = []
        self._bursts = 0
        self._busy_until_ns: int | None = None
        self._joins = 0
        self.onward: Onward | None = None
        """Of a relay: from its clock to the root's, for the clients to add to their estimates."""
        self._weigh_due_ns = 0
        self._present = 0
        self._silence_ns = 0
        """Nobody can have been silent for too long before this time."""
        self._times: deque[tuple[bytes, Address]] = deque()
        self._outbox: deque[tuple[Control, Address]] = deque()
        self._events: deque[LeaderEvent] = deque()

    @property
    def goal(self) -> Goal | None:
        """The grid of instants that all cameras are moved onto; None before the first camera."""
        return None if self.agreement is None else self.agreement.goal

    @property
    def pace_ns(self) -> int:
        """Mean time between two time requests of one client that this leader can bear, in ns; 0: any."""
        pace_ns = round(self._present * 1e9 / self.config.exchanges_per_s)
        return min(SLOWEST_PACE_NS, pace_ns) if pace_ns > FREE_PACE_NS else 0

    # In

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`; stamp it as near to the socket as can be."""
        try:
            message = decode(data)
        except WireError:
            self.malformed += 1
            return
        if isinstance(message, Hello):
            self._take_hello(message, address, now_ns)
            return
        if not isinstance(message, TimeRequest | Heartbeat | TriggerAck | Goodbye):
            return
        member = self._by_number.get(message.client)
        if member is None or member.lost:
            if isinstance(message, Heartbeat):
                self._outbox.append((Unknown(message.client), address))
            return
        member.address = address
        member.heard_ns = now_ns
        match message:
            case TimeRequest():
                self._times.append((reply_before_t2(message, now_ns), address))
            case Heartbeat():
                member.report = message.report
                if member.camera.phase_control in WEIGHTS:
                    self._agree(now_ns)
                self._outbox.append((self._answer(member), address))
            case TriggerAck():
                self._take_ack(member, message)
            case Goodbye():
                self._lose(member, "it left")

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        if now_ns >= self._silence_ns:
            self._find_silent(now_ns)
        for order in list(self._orders):
            if order.member.lost or now_ns >= order.give_up_ns:
                self._orders.remove(order)
                reason = order.member.lost or "it does not answer"
                self._events.append(BurstRefused(order.member.name, order.trigger.burst, reason))
            elif now_ns >= order.due_ns:
                order.due_ns = now_ns + TRIGGER_AGAIN_NS
                self._outbox.append((order.trigger, order.member.address))

    # Out

    def next_timer(self) -> int | None:
        """Leader time in ns at which `handle_timer` wants to be called, None for never."""
        silent = [self._silence_ns] if self._present else []
        return min(silent + [order.due_ns for order in self._orders], default=None)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams and where to; time replies carry `now_ns`, so send them at once."""
        datagrams = [(reply_at(before, now_ns), address) for before, address in self._times]
        self._times.clear()
        while self._outbox:
            message, address = self._outbox.popleft()
            datagrams.append((encode(message), address))
        return datagrams

    def next_event(self) -> LeaderEvent | None:
        """Return the next thing that happened, None where there is none."""
        return self._events.popleft() if self._events else None

    def clients(self, now_ns: int) -> tuple[ClientView, ...]:
        """Return all clients that are or were here, by name; lost ones say so in their report."""
        return tuple(
            ClientView(member.name, member.address, member.camera, member.report, now_ns - member.heard_ns)
            for _, member in sorted(self._members.items())
        )

    # Bursts

    def trigger(
        self, now_ns: int, *, frames: int, spacing: int = 1, at_leader_ns: int | None = None
    ) -> Burst:
        """Order a burst of `frames` instants, every `spacing` periods, snapped to the rig's grid.

        `at_leader_ns` may lie in the past, as far back as the clients' ring buffers reach; the default is
        half a second from now, put off by up to the leader's freedom. Raises BadInputError for an
        impossible burst, IncompleteError where no client is there to take it.
        """
        present = [
            member
            for _, member in sorted(self._members.items())
            if not member.lost and member.camera.kind != CLOCK_ONLY
        ]
        if not present or self.goal is None:
            raise IncompleteError(
                "no camera has joined", hint="start nodes with `capture-app node --leader HOST:PORT`"
            )
        step_ns = spacing * self.goal.period_ns
        if not possible(frames, step_ns):
            raise BadInputError(
                f"a burst of {frames} frames, every {spacing} periods, is not possible",
                hint=f"1 to {MAX_FRAMES} frames, spacing 1 or more, {MAX_BURST_NS // 10**9} s at most",
            )
        requested_ns = now_ns + TRIGGER_LEAD_NS if at_leader_ns is None else at_leader_ns
        placed_ns = self._place(present, requested_ns) if at_leader_ns is None else requested_ns
        instants_ns = burst_instants(self.goal, placed_ns, frames, spacing)
        self._bursts += 1
        self._busy_until_ns = max(now_ns, instants_ns[-1]) + AFTER_BURST_NS
        for member in present:
            trigger = Trigger(member.number, self._bursts, instants_ns[0], step_ns, frames)
            self._orders.append(_Order(member, trigger, now_ns + TRIGGER_GIVE_UP_NS))
        names = tuple(member.name for member in present)
        return Burst(self._bursts, instants_ns, self.goal.period_ns, requested_ns, names)

    # The parts

    def _place(self, present: list[_Member], requested_ns: int) -> int:
        if self.goal is None or self.config.freedom_ns <= 0:
            return requested_ns
        forecasts = [
            Forecast(report.frame_leader_ns, 0.0 if held else report.drift_ppm or 0.0)
            for report, held in (
                (member.report, member.camera.phase_control == "frame-duration") for member in present
            )
            if report.frame_leader_ns is not None
        ]
        return calmest(self.goal, forecasts, requested_ns, self.config.freedom_ns)

    def _answer(self, member: _Member) -> HeartbeatAck:
        assert self.agreement is not None, "the first hello sets the goal"
        goal = self.agreement.goal
        return HeartbeatAck(
            member.number,
            self.config.instance,
            goal.anchor_leader_ns,
            goal.period_ns,
            self.agreement.agreed_leader_ns,
            self.config.align_row,
            self.pace_ns,
            self.onward,
        )

    def _agree(self, now_ns: int) -> None:
        """Move the goal to suit the cameras that cannot follow it, and tell everybody; not near a burst."""
        if (
            self.agreement is None
            or self.onward is not None
            or (self._busy_until_ns is not None and now_ns < self._busy_until_ns)
            or (len(self._bound) > FEW_CAMERAS and now_ns < self._weigh_due_ns)
        ):
            return
        self._weigh_due_ns = now_ns + len(self._bound) * WEIGH_EVERY_NS
        standings = [
            Standing(
                member.name,
                member.camera.phase_control,
                member.report.frame_leader_ns,
                member.report.drift_ppm or 0.0,
                max(1, member.report.tolerance_ns),
            )
            for member in self._bound.values()
            if not member.lost
        ]
        if self.agreement.update(standings, now_ns):
            for member in self._members.values():
                if not member.lost:
                    self._outbox.append((self._answer(member), member.address))

    def _take_hello(self, hello: Hello, address: Address, now_ns: int) -> None:
        known = self._members.get(hello.name)
        if known is not None and not known.lost and known.instance != hello.instance:
            reason = f"another camera named {hello.name} is here"
            self._outbox.append((Refused(hello.instance, reason), address))
            return
        if not _NAME.fullmatch(hello.name):
            self._outbox.append((Refused(hello.instance, "its name cannot be a folder's"), address))
            return
        if known is None and len(self._members) >= MAX_CLIENTS:
            self._outbox.append((Refused(hello.instance, "the rig is full"), address))
            return
        if not MIN_PERIOD_NS <= hello.camera.period_ns <= MAX_PERIOD_NS:
            reason = f"a frame period of {hello.camera.period_ns} ns is not possible"
            self._outbox.append((Refused(hello.instance, reason), address))
            return
        if self.agreement is None:
            self.agreement = Agreement(Goal(now_ns, self.config.period_ns or hello.camera.period_ns))
        if known is None or known.lost or known.instance != hello.instance:
            if known is not None:
                self._by_number.pop(known.number, None)
            self._events.append(NodeJoined(hello.name) if known is None else NodeReturned(hello.name))
            number = self._free_number()
            report = Report(state=NodeState.JOINING)
            known = _Member(
                hello.name, hello.instance, number, address, hello.camera, report, now_ns, spread(self._joins)
            )
            self._joins += 1
            self._present += 1
            self._silence_ns = min(self._silence_ns, now_ns + CLIENT_SILENT_NS)
            self._members[hello.name] = self._by_number[number] = known
            self._bound.pop(hello.name, None)
            if hello.camera.phase_control in WEIGHTS:
                self._bound[hello.name] = known
        known.heard_ns = now_ns
        welcome = Welcome(
            hello.instance,
            self.config.instance,
            known.number,
            self.config.transfer_port,
            self.agreement.goal.anchor_leader_ns,
            self.agreement.goal.period_ns,
            known.slot,
            self.config.align_row,
            self.pace_ns,
            self.onward,
        )
        self._outbox.append((welcome, address))

    def _free_number(self) -> int:
        while True:
            number = self._rng.getrandbits(32)
            if number not in self._by_number:
                return number

    def _take_ack(self, member: _Member, ack: TriggerAck) -> None:
        for order in self._orders:
            if order.member is member and order.trigger.burst == ack.burst:
                self._orders.remove(order)
                if ack.refusal:
                    self._events.append(BurstRefused(member.name, ack.burst, ack.refusal))
                else:
                    self._events.append(BurstAccepted(member.name, ack.burst))
                return

    def _find_silent(self, now_ns: int) -> None:
        """Lose those who are silent, and note when the next one could be."""
        self._silence_ns = now_ns + CLIENT_SILENT_NS
        for member in self._members.values():
            if member.lost:
                continue
            patience_ns = CLOCK_SILENT_NS if member.camera.kind == CLOCK_ONLY else CLIENT_SILENT_NS
            if now_ns - member.heard_ns >= patience_ns:
                self._lose(member, f"silent for {patience_ns // 10**9} s")
            else:
                self._silence_ns = min(self._silence_ns, member.heard_ns + patience_ns)

    def _lose(self, member: _Member, reason: str) -> None:
        self._present -= 1
        member.lost = reason
        member.report = Report(
            state=NodeState.LOST, message=reason, frames=member.report.frames, drops=member.report.drops
        )
        self._events.append(NodeLost(member.name, reason))
