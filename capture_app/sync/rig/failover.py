"""Failover to the next leader when one is lost, and failback to a preferred one when it returns."""

from typing import Any

from capture_app.common.node_state import NodeState
from capture_app.sync.rig.client import Client
from capture_app.sync.rig.time_client import HELLOS, TimeClient
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.poll_schedule import NEVER_NS
from capture_app.sync.wire.codec import Message, encode
from capture_app.sync.wire.datagrams import PROBE_NUMBER, Heartbeat, Report, UnknownMember

PROBE_EVERY_NS = 15_000_000_000
"""Interval of liveness probes to a leader of better rank; four answers (MIN_ANSWERS) take a minute."""
MIN_ANSWERS, MAX_ANSWERS = 4, 64
"""Consecutive liveness probes that a preferred leader must answer before it is followed again. The number
doubles, up to the maximum, each time it fails soon after."""
SHORT_STAY = 4
"""A stay shorter than this multiple of the preceding probing time counts as an early failure."""
_PROBE = encode(Heartbeat(PROBE_NUMBER, Report(state=NodeState.JOINING)))
"""Liveness probe: a heartbeat of no client, which every leader answers with `UnknownMember`."""


class LeaderChoice:
    """Choice among several leaders of the one that a node follows or joins; connects the node to its address.

    It probes the leaders preferred to that one. `now_ns` is the node's own clock.
    """

    def __init__(
        self, leaders: tuple[Address, ...], time: TimeClient, probe_every_ns: int = PROBE_EVERY_NS
    ) -> None:
        """`leaders`, preferred first, must lead to the same root; `time` is the node's membership."""
        # Two names may have one address.
        self.leaders, self.leader = tuple(dict.fromkeys(leaders)), leaders[0]
        """All leaders, and the one that is followed or currently asked to join."""
        self.time = time
        """Membership and clock of the node."""
        self.probe_due_ns = NEVER_NS
        """Time of the next probes."""
        self._probe_every_ns = probe_every_ns
        self._outbox: list[tuple[bytes, Address]] = []
        """Messages to other leaders than the current one."""
        self._was_member = False
        self._found_by_probes = False
        """Whether the current leader was chosen by probes, not by asking each in turn."""
        self._needed = dict.fromkeys(leaders, MIN_ANSWERS)
        self._answers: dict[Address, int] = {}
        """Consecutive answers of each probed leader before its latest probe."""
        self._answered: set[Address] = set()
        self._probed: list[Address] = []
        self._back_since_ns: int | None = None

    def update(self, now_ns: int) -> None:
        """Note whether the leader is present; switch to the next one when hellos stay unanswered.

        After a loss nothing is probed until another leader is joined.
        """
        if self.time.is_member is not self._was_member:
            self._was_member = self.time.is_member
            if self._was_member:
                self._note_join(now_ns)
            else:
                if self._back_since_ns is not None:
                    needed = self._needed[self.leader]
                    soon = now_ns - self._back_since_ns < SHORT_STAY * needed * self._probe_every_ns
                    self._needed[self.leader] = min(2 * needed, MAX_ANSWERS) if soon else MIN_ANSWERS
                self._probe_from(NEVER_NS)
        if self.time.hellos > HELLOS:
            self.leader = self.leaders[(self.leaders.index(self.leader) + 1) % len(self.leaders)]
            self.time.hellos = 1
            self._found_by_probes = False

    def move_leader(self, old: Address, new: Address, now_ns: int) -> None:
        """Join a leader at its new address; whatever has the old one is left."""
        self.leaders = tuple(dict.fromkeys(new if leader == old else leader for leader in self.leaders))
        self._needed.setdefault(new, MIN_ANSWERS)
        if self.time.is_member:
            self.time.lose("another leader has its address", now_ns)
        self.update(now_ns)
        self.leader, self.time.hellos = new, 0

    def change_to(self, leader: Address, now_ns: int) -> None:
        """Follow another leader, which was chosen by probes."""
        self.leader, self._found_by_probes = leader, True
        if self.time.is_member:
            self._note_join(now_ns)

    def _note_join(self, now_ns: int) -> None:
        self._back_since_ns = now_ns if self._found_by_probes else None
        self._probe_from(now_ns if len(self.leaders) > 1 else NEVER_NS)

    def _probe_from(self, due_ns: int) -> None:
        """Forget all answers, and probe again at a local time in ns."""
        self.probe_due_ns = due_ns
        for known in (self._answers, self._answered, self._probed):
            known.clear()

    def note_answer(self, address: Address) -> None:
        """Record that a leader has answered a probe."""
        if address in self._answers:
            self._answered.add(address)

    def probe_if_due(self, now_ns: int) -> Address | None:
        """Probe all leaders preferred to the current one if due; return one that has answered often enough.

        A leader in holdover ranks last, and is left at the first answer of another.
        """
        followed = self.time.followed
        if now_ns < self.probe_due_ns or followed is None or not self.time.is_member:
            return None
        self.probe_due_ns = now_ns + self._probe_every_ns
        others = [address for address in self.leaders if address != self.leader]
        better = others if followed.in_holdover else self.leaders[: self.leaders.index(self.leader)]
        self._answers = {a: self._answers.get(a, 0) + 1 if a in self._answered else 0 for a in better}
        self._answered.clear()
        self._probed = list(better)
        needed = dict.fromkeys(better, 1) if followed.in_holdover else self._needed
        return next((a for a in better if self._answers[a] >= needed[a]), None)

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Process a datagram that arrived at `now_ns`; one that is from none of the leaders is ignored."""
        if address in self.leaders and (message := self.time.decode(data)) is not None:
            self.receive_message(message, address, now_ns)

    def receive_message(self, message: Message, address: Address, now_ns: int) -> None:
        """Process a message of one of the leaders that arrived at `now_ns`; preferred ones answer probes."""
        if address == self.leader:
            self.time.receive_message(message, now_ns)
            self.update(now_ns)
        elif isinstance(message, UnknownMember) and message.client == PROBE_NUMBER:
            self.note_answer(address)

    def handle_timer(self, now_ns: int) -> None:
        """Do everything that is due; call it at `next_timer`, or at any other time."""
        self.time.handle_timer(now_ns)
        self.update(now_ns)
        if (better := self.probe_if_due(now_ns)) is not None:
            self.try_to_join(better, now_ns)

    def try_to_join(self, better: Address, now_ns: int) -> None:
        """Join a preferred leader that has answered often enough, if that suits the node now."""

    def leave(self) -> None:
        """Say goodbye, as this node is about to stop."""
        self.time.leave()

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` is due."""
        return min(self.time.next_timer(), self.probe_due_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams with their destinations; send at once, as a time request carries `now_ns`."""
        datagrams = [(data, self.leader) for data in self.time.datagrams_to_send(now_ns)]
        datagrams += self._outbox + [(_PROBE, address) for address in self._probed]
        self._outbox.clear()
        self._probed.clear()
        return datagrams


class Failover(LeaderChoice):
    """Choice among the leaders of a camera's client, which leaves one before it joins a better one."""

    def __init__(
        self, client: Client[Any], leaders: tuple[Address, ...], probe_every_ns: int = PROBE_EVERY_NS
    ) -> None:
        """Create a failover among `leaders`, preferred first, which must lead to the same root."""
        super().__init__(leaders, client, probe_every_ns)
        self._client = client

    def try_to_join(self, better: Address, now_ns: int) -> None:
        """Change to a preferred leader unless a burst is pending, or the client is not ready."""
        if self._client.state.is_aligned and not self._client.has_burst_pending:
            self._client.change_leader("a better leader is there", now_ns)
            self.update(now_ns)
            self.change_to(better, now_ns)
