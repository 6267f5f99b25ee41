"""State machine of a leader: admits clients, answers time requests, orders bursts, detects lost members.

Time replies are stamped when they leave, and are sent before all other datagrams.
"""

import random
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from msgspec import structs

from capture_app.common.bounds import MAX_TEXT, cut
from capture_app.common.errors import BadInputError
from capture_app.common.node_state import RELAY, WITHOUT_CAMERA, NodeState
from capture_app.common.stagger import Stagger
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.phase.grid_phase_choice import GridPhaseChoice
from capture_app.sync.rig import status_text
from capture_app.sync.rig.burst_orders import BurstOrder, Orders
from capture_app.sync.rig.events import LeaderEvent, NodeChanged
from capture_app.sync.rig.frame_selection import Burst
from capture_app.sync.rig.relay_summary import RelaySummary
from capture_app.sync.rig.rig_config import CurrentConfig, RequestedConfig
from capture_app.sync.rig.roster import LEFT, Member, Roster, camera_phases, relays_above
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.poll_schedule import AT_ONCE_NS, FIRST_INTERVAL_NS
from capture_app.sync.wire.codec import (
    FromClient,
    FromMember,
    WireError,
    decode,
    encode,
    other_version,
    reply_at,
    reply_before_t2,
    version_answer,
)
from capture_app.sync.wire.datagrams import (
    MAX_OTHERS,
    ControlMessage,
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    JoinRefusal,
    MemberReports,
    Notice,
    Principal,
    TimeRequest,
    Trigger,
    TriggerAck,
    UnknownMember,
    UpstreamMap,
    Welcome,
    camera_key,
)

FEW_CAMERAS, UPDATE_EVERY_NS = 20, 200_000
"""With more than FEW_CAMERAS cameras the grid is updated once per UPDATE_EVERY_NS and camera, not at each
heartbeat."""
MIN_REPORT_INTERVAL_NS, REPEAT_REPORT_NS, MAX_REPORTED = 5_000_000_000, 600_000_000_000, 256
"""Interval between two reported refusals of one machine; interval for an unchanged reason; machines
remembered."""
MAX_POLL_INTERVAL_NS = 60_000_000_000
"""Maximum request interval that an overloaded leader asks for: a clock that drifts by 0.05 ppm/s is off by 90
us."""
WAITED_FRACTION = 1.0 / 64.0
"""Weight of one request in the mean delay, which some 64 requests determine: 0.13 s at MIN_FRACTION."""
MOVES = "it moves to its planned delay"
"""Message of a staggered camera until it reports again."""
LOADED_NS = 2_000_000
"""Mean delay of time replies, from the kernel's timestamp of the request, above which the leader is
overloaded."""
MIN_FRACTION = 0.025
"""Minimum fraction of its request rate that an overloaded leader accepts: 500 requests a second.

200 nodes over a cable are then ready after 7.9 s, and 40 nodes at their rate over WiFi after 26 s. On the
paper's link, where one message in eighty is quick, 12 of 40 are ready after 37 s (all simulated).
"""
RETURN_NS = 5_000_000_000
"""Time after a takeover in which staggered cameras keep their delays: they join one after the other."""
RELIEF, RISE, ADAPT_EVERY_NS = 0.7, 1.05, 250_000_000
"""Factors of the accepted request rate when overloaded and when not, and the interval of this adaptation."""


@dataclass(frozen=True, slots=True)
class LeaderConfig:
    """Configuration of a leader's engine."""

    instance: int
    transfer_port: int
    rig: RequestedConfig = field(default_factory=RequestedConfig)
    exchanges_per_s: float = 20_000.0
    """Maximum rate of time requests of all clients together; more clients each send fewer. An overloaded
    leader accepts fewer.
    """
    continues: UpstreamMap | None = None
    """Map from this leader's clock to the clock of the leader that it replaces."""
    grid: FrameGrid | None = None
    """Grid of the replaced leader, which this one continues."""


class Leader:
    """Leader side of the protocol; `now_ns` is the leader's clock, which is the rig's time.

    The leader side of a relay has a `summary`, to which it forwards the clients' messages and from which it
    receives bursts.
    """

    def __init__(
        self,
        config: LeaderConfig,
        rng: random.Random,
        summary: RelaySummary | None = None,
        owners: dict[str, str] | None = None,
    ) -> None:
        """`owners` maps names to the pins of their machines, from earlier runs; it is updated in place."""
        self.config = config
        self.current = CurrentConfig(config.instance, config.rig, continues=config.continues)
        if config.grid is not None:
            self.current.grid_choice, self.current.grid_is_of_cameras = GridPhaseChoice(config.grid), True
            self.current.delays_ns = {} if config.rig.stagger is None else None
        self.impostures = 0
        """Messages whose seal belongs to another machine than the one they name."""
        self._summary = summary
        self.roster = Roster(rng, owners)
        """All members, including lost ones."""
        self._reported: dict[str, tuple[str, int]] = {}
        """Last reported refusal and its time, by machine pin or, without one, by host."""
        self.orders = Orders(config.instance, self.roster)
        """Bursts ordered from the members."""
        self._review_is_due = False
        """Whether the set of cameras that the grid and delays were chosen for may have changed."""
        self._delays_due_ns: int | None = None
        """Time from which cameras that were taken over get new delays; None before any delays are planned."""
        self._update_due_ns = 0
        self._times: deque[tuple[bytes, Address, int]] = deque()
        """Pending time replies, each with the arrival time of its request."""
        self._outbox: list[tuple[bytes, Address]] = []
        self._waited_ns = 0.0
        """Running mean of the time from the arrival of a time request to its reply, in ns."""
        self._events: deque[LeaderEvent] = deque()
        self._rate_fraction, self._adapt_due_ns = 1.0, AT_ONCE_NS

    @property
    def grid(self) -> FrameGrid | None:
        """Grid of instants that all cameras are moved onto; None before the first camera."""
        return self.current.grid

    @property
    def poll_interval_ns(self) -> int:
        """Shortest mean interval of a client's time requests that this leader can serve, in ns; 0: any."""
        poll_interval_ns = round(
            self.roster.pollers * 1e9 / (self._rate_fraction * self.config.exchanges_per_s)
        )
        return min(MAX_POLL_INTERVAL_NS, poll_interval_ns) if poll_interval_ns > FIRST_INTERVAL_NS else 0

    # In

    def receive_datagram(
        self, data: bytes, address: Address, now_ns: int, principal: Principal | None = None
    ) -> None:
        """Process a datagram that arrived at `now_ns`, stamped as close to the socket as possible."""
        try:
            message = decode(data)
        except WireError:
            self.report_version(data, address, now_ns)
            return
        if isinstance(message, FromClient):
            self.receive_message(message, address, now_ns, principal)

    def receive_message(
        self, message: FromClient, address: Address, now_ns: int, principal: Principal | None = None
    ) -> None:
        """Process a message that arrived at `now_ns`, sealed by `principal` in a rig with seals.

        A relay's batched message is processed as one message of each of its members.
        """
        match message:
            case Hello():
                self._receive_hello(message, address, now_ns, principal)
            case MemberReports():
                for number, report in message.reports:
                    self._receive_of_member(Heartbeat(number, report), address, now_ns, principal)
            case TriggerAck(others=others) if others:
                for number in (message.client, *others):
                    answer = structs.replace(message, client=number, others=())
                    self._receive_of_member(answer, address, now_ns, principal)
            case _:
                self._receive_of_member(message, address, now_ns, principal)

    def forget(self, name: str) -> None:
        """Remove a lost member and release its name, so that any machine may use it.

        Raises BadInputError if no node has that name, or if it is not lost.
        """
        member = self.roster.members.get(name)
        if member is not None and not member.lost:
            raise BadInputError(f"{name} is here", hint="stop it first: it would join again")
        if self.roster.owners.pop(name, None) is None and member is None:
            raise BadInputError(f"no node named {name} is known", hint="capture-app status lists the nodes")
        self._note_lost(NodeChanged(name, "forgotten") if member is None else self.roster.forget(member))

    def set_stagger(self, stagger: Stagger | None, now_ns: int) -> None:
        """Take frames in another planned order, None for all at one instant; after a burst under way."""
        self.current.config = replace(self.current.config, stagger=stagger)
        self._review_is_due = True
        self._review_if_due(now_ns)

    def leave(self) -> None:
        """Ask the members to join another leader, as this one is about to stop."""
        for member in self.roster.members.values():
            if not member.lost and member.via is None:
                self.send(member, UnknownMember(member.number, stops=True))

    def handle_timer(self, now_ns: int) -> None:
        """Do everything that is due; call it at `next_timer`, or at any other time."""
        for change in (*self.roster.mark_silent_lost(now_ns), *self.roster.forget_long_lost(now_ns)):
            self._note_lost(change)
        self._review_if_due(now_ns)
        self._events.extend(self.orders.expire(now_ns))
        for members, trigger in self.orders.triggers_due(now_ns):
            self.send_trigger(members, trigger)

    # Out

    def next_timer(self) -> int:
        """Leader time in ns at which `handle_timer` is due."""
        return min(self.roster.next_timer(), self.orders.next_timer())

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams with their destinations; send at once, as time replies carry `now_ns`."""
        datagrams = [(reply_at(before, now_ns), address) for before, address, _ in self._times]
        for _, _, arrived_ns in self._times:
            self._waited_ns += WAITED_FRACTION * (now_ns - arrived_ns - self._waited_ns)
        self._times.clear()
        datagrams += self._outbox
        self._outbox.clear()
        if datagrams and now_ns >= self._adapt_due_ns:
            self._adapt_due_ns = now_ns + ADAPT_EVERY_NS
            change = RELIEF if self._waited_ns > LOADED_NS else RISE
            self._rate_fraction = min(max(change * self._rate_fraction, MIN_FRACTION), 1.0)
        return datagrams

    def next_event(self) -> LeaderEvent | None:
        """Return the next event, or None."""
        return self._events.popleft() if self._events else None

    # Bursts

    def trigger(self, now_ns: int, order: BurstOrder) -> Burst:
        """Order a burst on the rig's grid. Raises as `Orders.check` does."""
        return self.orders.place(self.grid, now_ns, order)

    def planned_delays_ns(self) -> dict[str, int]:
        """Return each camera's planned delay: 0 in a rig in step, or while delays are not planned yet."""
        delays_ns = self.current.delays_ns or {}
        return {name: delays_ns.get(camera_key(name), 0) for name in self.roster.members}

    def resume(self, burst: Burst, run: int, delays_ns: Mapping[str, int], now_ns: int) -> None:
        """Order the rest of a streamed burst of this leader's earlier `run`, with its grid and delays.

        A leader that continues another one's time, or has another period, does not.
        """
        if self.config.continues is not None or self.config.rig.period_ns not in (None, burst.period_ns):
            return
        if not self.orders.is_busy(now_ns):
            grid = FrameGrid(burst.instants_ns[0], burst.period_ns)
            self.current.grid_choice, self.current.grid_is_of_cameras = GridPhaseChoice(grid), True
            # A camera that was started again, too, has forgotten its own.
            self.current.delays_ns = {camera_key(name): delay for name, delay in delays_ns.items() if delay}
            self.acknowledge_all()
        self.orders.resume(burst, run, now_ns)

    def send(self, member: Member, message: ControlMessage) -> None:
        """Send a message to a member."""
        self._outbox.append((encode(message), member.address))

    def send_trigger(self, members: Iterable[Member], trigger: Trigger) -> None:
        """Send a trigger to members, with one datagram for many members below the same relay."""
        below: dict[Address, list[int]] = {}
        for member in members:
            if member.via is None:
                self.send(member, structs.replace(trigger, client=member.number, others=()))
            else:
                below.setdefault(member.address, []).append(member.number)
        for address, numbers in below.items():
            for i in range(0, len(numbers), MAX_OTHERS):
                client, *others = numbers[i : i + MAX_OTHERS]
                batch = structs.replace(trigger, client=client, others=tuple(others))
                self._outbox.append((encode(batch), address))

    def report_version(self, data: bytes, address: Address, now_ns: int) -> None:
        """Answer a datagram of another protocol version with this leader's version; report its node."""
        if (answer := version_answer(data)) is not None:
            self._outbox.append((answer, address))
            self.note_version(data, address, now_ns)

    def note_version(self, data: bytes, address: Address, now_ns: int) -> None:
        """Report the node of a datagram that is of another protocol version."""
        host, reason = address[0], other_version(data)
        # Anyone can send these from any address: for all hosts together there is a limit, too.
        if reason and self._is_unreported("", host, now_ns) and self._is_unreported(host, reason, now_ns):
            self._events.append(NodeChanged("a node", "refused", reason, f"at {host}"))

    def refuse(self, hello: Hello, reason: str, address: Address, *, retry_here: bool = False) -> None:
        """Send a client the reason why it cannot join; with `retry_here` it should not try another leader."""
        self._outbox.append((encode(JoinRefusal(hello.instance, cut(reason), retry_here)), address))

    def acknowledge(self, member: Member) -> None:
        """Acknowledge a member's newest heartbeat, with the current configuration."""
        self.send(
            member,
            HeartbeatAck(member.number, self.current.message(self.poll_interval_ns, self._staggered(member))),
        )

    def acknowledge_all(self) -> None:
        """Send every member that is not below a relay the current configuration."""
        for member in self.roster.members.values():
            if not member.lost and member.via is None:
                self.acknowledge(member)

    def drop_member(self, member: Member, reason: str) -> None:
        """Mark a member as lost and notify it, so that it asks to join again if it is still running."""
        self._note_lost(self.roster.mark_lost(member, reason))
        self.send(member, UnknownMember(member.number))

    # The parts

    def _receive_of_member(
        self, message: FromMember, address: Address, now_ns: int, principal: Principal | None
    ) -> None:
        if (member := self._sender(message, address, now_ns, principal)) is None:
            return
        match message:
            case TimeRequest():
                self._times.append((reply_before_t2(message, now_ns), address, now_ns))
            case Heartbeat():
                self._receive_heartbeat(member, message, now_ns)
            case TriggerAck():
                self._pass_up(member, message, now_ns)
                if (answer := self.orders.take_ack(member, message)) is not None:
                    self._events.append(answer)
            case Goodbye():
                self._note_lost(self.roster.mark_lost(member, LEFT))

    def _sender(
        self, message: FromMember, address: Address, now_ns: int, principal: Principal | None
    ) -> Member | None:
        """Return the sender of a message and note that it is present; None if it is not a member."""
        if (member := self.roster.member_by_number(message.client)) is None:
            if isinstance(message, Heartbeat):
                self._outbox.append((encode(UnknownMember(message.client)), address))
            return None
        if member.principal != principal:
            self.impostures += 1
            return None
        member.address = address
        member.last_heard_ns = now_ns
        # A relay reports the loss also of a client that has sent only hellos.
        is_lost = isinstance(message, Heartbeat) and message.report.state is NodeState.LOST
        if not is_lost and self.roster.confirm(member):
            self._review_is_due |= self.current.is_staggered or not self.current.is_held(member.camera)
        return member

    def _pass_up(self, member: Member, message: Hello | Heartbeat | TriggerAck, now_ns: int) -> bool:
        return self._summary is not None and self._summary.pass_up(member, message, now_ns)

    def _receive_heartbeat(self, member: Member, message: Heartbeat, now_ns: int) -> None:
        if message.report.state is NodeState.LOST:
            event = self.roster.mark_lost(member, message.report.message or LEFT)
            self._note_lost(self.roster.forget(member) if member.is_unknown else event)
            return
        is_new = self._pass_up(member, message, now_ns)
        if message.report.state.is_aligned and not member.report.state.is_aligned:
            self.orders.order_again(member, now_ns)
        member.report = message.report
        if member.name in self.roster.immovable:
            if self._update_grid(now_ns):
                self.acknowledge_all()
            jumps_ns = {} if self.current.grid_choice is None else self.current.grid_choice.jumps_ns
            if member.name in jumps_ns:
                member.report = status_text.jumped(member.report, jumps_ns[member.name])
        if self.current.is_staggered:
            # A camera that has just joined must not count as ready with a delay that it is about to lose.
            self._review_if_due(now_ns)
        if member.via is None and not is_new:
            self.acknowledge(member)

    def _review_if_due(self, now_ns: int) -> None:
        # The root decides the grid of a relay.
        if self._review_is_due and self._summary is None and self._review_grid(now_ns):
            self.acknowledge_all()

    def _review_grid(self, now_ns: int) -> bool:
        """Change the grid's period if another suits more cameras, and the delays, except near a burst.

        Return whether anything has changed. A camera that has sent only hellos has no vote if a confirmed one
        is present.
        """
        if self.orders.is_busy(now_ns):
            return False
        self._review_is_due = False
        voters = self.roster.cameras() or self.roster.cameras(even_unconfirmed=True)
        has_changed = self.current.follow_cameras(voters, now_ns)
        return (self.current.is_staggered and self._plan_delays(now_ns)) or has_changed

    def _plan_delays(self, now_ns: int) -> bool:
        """Plan the delays of the cameras on the grid; return whether they have changed.

        A camera that is lost keeps its place until it is forgotten, so that a fault of its link moves no
        other one. A camera that signs off gives it up.
        """
        current = self.current
        self._delays_due_ns = self._delays_due_ns or now_ns + RETURN_NS
        self._review_is_due = current.delays_ns is None and now_ns < self._delays_due_ns
        if self._review_is_due or self.grid is None:
            return False
        places = {
            name: member
            for name, member in self.roster.members.items()
            if member.is_confirmed
            and member.lost != LEFT
            and member.camera.kind not in WITHOUT_CAMERA
            and current.is_held(member.camera)
        }
        stagger, before = current.config.stagger, current.delays_ns
        planned_ns = {} if stagger is None else stagger.plan_ns(places, self.grid.period_ns)
        current.delays_ns = planned = {camera_key(name): delay_ns for name, delay_ns in planned_ns.items()}
        # After a takeover they have their delays already.
        known = planned if before is None else before
        for name, member in places.items():
            key, is_ready = camera_key(name), member.report.state.is_aligned
            if is_ready and known.get(key, 0) != planned.get(key, 0):
                # Until it reports again it must not count as ready.
                member.report = structs.replace(member.report, state=NodeState.ALIGNING, message=MOVES)
        return planned != before

    def _staggered(self, member: Member) -> list[str]:
        """Return the cameras whose planned delays a member is to know: itself, or those below a relay."""
        if not self.current.is_staggered or member.camera.kind != RELAY:
            return [member.name]
        members = self.roster.members
        return [name for name, below in members.items() if member in relays_above(below, members)]

    def _update_grid(self, now_ns: int) -> bool:
        """Shift the grid's phase to suit cameras that can only be restarted, except near a burst.

        In a burst the grid stays, and cameras that rejoin are restarted until they meet it. Return whether
        the cameras have to know of a change.
        """
        shared, immovable = self.current.grid_choice, len(self.roster.immovable)
        if shared is None or self.current.upstream is not None:
            return False
        if self.orders.is_busy(now_ns):
            is_new, shared.common_instant_leader_ns = shared.common_instant_leader_ns is None, now_ns
            return is_new
        if immovable > FEW_CAMERAS and now_ns < self._update_due_ns:
            return False
        self._update_due_ns = now_ns + immovable * UPDATE_EVERY_NS
        return shared.update(
            camera_phases(self.roster.immovable.values()), now_ns, is_ready=self.roster.is_ready()
        )

    def evict(self, member: Member) -> None:
        """Remove a member, present or lost, whose name belongs to another machine."""
        if not member.lost:
            self.drop_member(member, "its name is another machine's")
        self._events.append(self.roster.forget(member))

    def _report_refusal(self, hello: Hello, reason: str, address: Address, now_ns: int) -> None:
        """Refuse a client; at intervals report it to the operator and to the name's present camera."""
        self.refuse(hello, reason, address)
        if not self._is_unreported(hello.pin or address[0], reason, now_ns):
            return
        where = f"at {address[0]}" if hello.via is None else f"below {hello.via}"
        self._events.append(NodeChanged(hello.name, "refused", reason, where))
        owner = self.roster.members.get(hello.name)
        if owner is not None and not owner.lost and owner.instance != hello.instance:
            text = f"another camera {where} wants to be {hello.name}, too: give one another --name"
            self.send(owner, Notice(owner.number, text[:MAX_TEXT]))

    def _is_unreported(self, who: str, reason: str, now_ns: int) -> bool:
        reported, reported_ns = self._reported.get(who, ("", now_ns - REPEAT_REPORT_NS))
        if now_ns - reported_ns < (REPEAT_REPORT_NS if reported == reason else MIN_REPORT_INTERVAL_NS):
            return False
        if len(self._reported) >= MAX_REPORTED:
            del self._reported[next(iter(self._reported))]
        self._reported[who] = reason, now_ns
        return True

    def _note_lost(self, event: NodeChanged) -> None:
        self._events.append(event)
        self._review_is_due = True

    def _receive_hello(
        self, hello: Hello, address: Address, now_ns: int, principal: Principal | None
    ) -> None:
        if principal is not None and not principal.may_introduce(hello):
            self.impostures += 1
            return
        # Only the seal proves the client's machine; the pin in its message does not.
        sealed_by = "" if principal is None else principal.pin
        hello = structs.replace(hello, pin=(hello.via and sealed_by and hello.pin) or sealed_by)
        refusal = self.roster.refusal(hello)
        if refusal and self._summary is not None and self.roster.is_of_another_machine(hello):
            self._summary.ask(hello)
        if not refusal and principal is not None and hello.via is not None:
            refusal = self.roster.refusal_below(principal, hello)
        if refusal := refusal or ("" if self._summary is None else self._summary.refusal(hello)):
            self._report_refusal(hello, refusal, address, now_ns)
            return
        # The root decides the grid of a relay.
        if self._summary is None and self.current.lay_grid(hello.camera, now_ns):
            self.acknowledge_all()
        self._events.extend(self.roster.make_room(hello))
        member, event = self.roster.admit(hello, address, now_ns, principal)
        if self._summary is None and hello.pin:
            self.roster.claim(hello)
        if event is not None:
            self._events.append(event)
        welcome = Welcome(
            instance=hello.instance,
            client=member.number,
            transfer_port=self.config.transfer_port,
            config=self.current.message(self.poll_interval_ns, self._staggered(member)),
            slot=member.slot,
        )
        self._outbox.append((encode(welcome), address))
        self._pass_up(member, hello, now_ns)
