"""What a relay owes the root and its cameras, in histories that are drawn.

Whatever is lost on the way, and whoever comes, goes or is started again: soon the root knows each camera
below the relay as it is, and its bursts reach all of them.
"""

import random
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

from hypothesis import given, settings

from capture_app.common.node_state import NodeState
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.events import TriggerAnswered
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.relay_summary import REPORT_INTERVAL_NS
from capture_app.sync.rig.roster import LEFT
from capture_app.sync.sync_engine import Address
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.tree.relay_engine import OF_CAMERAS, Relay
from capture_app.sync.wire.codec import FromClient, decode, encode
from capture_app.sync.wire.datagrams import (
    Goodbye,
    Heartbeat,
    Hello,
    JoinRefusal,
    Report,
    Trigger,
    TriggerAck,
    UnknownMember,
    Welcome,
)
from tests.facts import make_facts
from tests.histories import histories
from tests.unit.sync.tree.seldom import S, Seldom

STEP_NS = 10**8
SOON_S, LATER_S = 4, 12
"""When the root knows all that is: if no message was lost, and if some were."""
ROOT, GATE = ("root", 1), ("gate", 1)
NAMES = ("a", "b", "c")
STATES = (NodeState.SYNCING, NodeState.READY, NodeState.FAILED)


@dataclass
class Camera:
    """A camera below the relay, as far as a relay sees one."""

    name: str
    instance: int
    state: NodeState = NodeState.SYNCING
    number: int | None = None
    has_left: bool = False
    refusal: str = ""
    beat_ns: int = 0
    frames: int = 0

    @property
    def report(self) -> Report:
        return Report(state=self.state, frames=self.frames)

    def message(self, now_ns: int) -> FromClient | None:
        """Return what it says now: twice a second it asks to join, or reports."""
        if self.has_left or now_ns < self.beat_ns + S // 2:
            return None
        self.beat_ns = now_ns
        if self.number is None:
            return Hello(self.name, self.instance, make_facts())
        self.frames += 10
        return Heartbeat(self.number, self.report)


class World:
    """A root, a relay and cameras below it; each method is something that happens."""

    def __init__(self) -> None:
        self.rng, self.now_ns, self.loss, self.runs = random.Random(1), 100 * S, 0.0, 10
        self.root = self._root()
        member = TreeMember("gate", 2, (ROOT,), random.Random(2), OF_CAMERAS)
        keeper = member.time.timekeeper
        keeper.schedule, keeper.time_is_known, keeper.path = Seldom(), True, (1,)
        keeper.time_map = TimeMap(0, 0, 0.0, 1.0, 2.0, 0.0, 0.0, 9, 9)
        self.relay = Relay(member, LeaderConfig(2, 0), random.Random(3))
        self.cameras: dict[str, Camera] = {}
        self.lost: dict[str, Camera] = {}
        """Cameras that were killed, or have left."""
        self.triggers: dict[str, list[Trigger]] = {name: [] for name in NAMES}
        self.is_lossy = False
        """Whether a message may have been lost, or its receiver."""
        self.sent = Counter[str]()
        """Messages of each kind that the relay has sent to the root."""
        for number in range(3):
            self.join(number)
        self.wait(2)

    def _root(self) -> Leader:
        return Leader(LeaderConfig(1, 0), random.Random(self.now_ns))

    # What happens

    def join(self, number: int) -> None:
        name = NAMES[number % 3]
        if name not in self.cameras:
            self.runs += 1
            self.cameras[name] = Camera(name, self.runs)

    def kill(self, number: int) -> None:
        name = NAMES[number % 3]
        if name in self.cameras:
            self.lost[name] = self.cameras.pop(name)

    def restart(self, number: int) -> None:
        self.kill(number)
        self.join(number)

    def sign_off(self, number: int) -> None:
        """It says goodbye to the relay, which hears it."""
        name = NAMES[number % 3]
        if name in self.cameras and self.cameras[name].number is not None:
            camera = self.lost[name] = self.cameras.pop(name)
            camera.has_left = True
            self.relay.receive_datagram(encode(Goodbye(camera.number or 0)), (name, 1), self.now_ns)

    def change(self, number: int) -> None:
        if (camera := self.cameras.get(NAMES[number % 3])) is not None:
            camera.state = STATES[number // 3 % 3]

    def lose_messages(self, number: int) -> None:
        """Between relay and root, from now on."""
        self.loss = (0.0, 0.3, 0.6)[number % 3]
        self.is_lossy |= self.loss > 0

    def restart_root(self, number: int) -> None:
        self.is_lossy = True
        self.root = self._root()

    def wait(self, number: int) -> None:
        end_ns = self.now_ns + (1 + number % 5) * S
        while self.now_ns < end_ns:
            self.now_ns += STEP_NS
            for name, camera in self.cameras.items():
                if (message := camera.message(self.now_ns)) is not None:
                    self.relay.receive_datagram(encode(message), (name, 1), self.now_ns)
            self.relay.handle_timer(self.now_ns)
            self.root.handle_timer(self.now_ns)
            for _ in range(4):
                for data, address in self.relay.datagrams_to_send(self.now_ns):
                    self._deliver(data, address)
                for data, address in self.root.datagrams_to_send(self.now_ns):
                    assert address == GATE
                    if self.rng.random() >= self.loss:
                        self.relay.receive_datagram(data, ROOT, self.now_ns)

    def _deliver(self, data: bytes, address: Address) -> None:
        if address == ROOT:
            self.sent[type(decode(data)).__name__] += 1
            if self.rng.random() >= self.loss:
                self.root.receive_datagram(data, GATE, self.now_ns)
            return
        camera, message = self.cameras.get(address[0]), decode(data)
        if camera is None:
            return
        if isinstance(message, Welcome | JoinRefusal):
            if message.instance == camera.instance:
                camera.number = message.client if isinstance(message, Welcome) else None
        elif getattr(message, "client", None) != camera.number:
            return  # It is for an earlier run.
        elif isinstance(message, UnknownMember):
            camera.number = None
        elif isinstance(message, Trigger):
            self.triggers[camera.name].append(message)
            ack = TriggerAck(
                message.client, message.leader, message.burst, "" if camera.state == "ready" else "no"
            )
            self.relay.receive_datagram(encode(ack), address, self.now_ns)

    # What must be true

    def check(self) -> None:
        """Soon after nothing is lost any more, the root knows what is."""
        self.loss = 0.0
        for _ in range(LATER_S if self.is_lossy else SOON_S):
            self.sent.clear()
            self.wait(0)
        assert self.sent["MemberReports"] <= S // REPORT_INTERVAL_NS + 1
        assert self.sent["Hello"] == 0, "all are known"
        members = self.root.roster.members
        assert not members["gate"].lost
        for name, camera in self.cameras.items():
            member = members[name]
            assert (member.instance, member.via, member.lost) == (camera.instance, "gate", "")
            assert member.report.state == camera.state
            assert member.report.frames > camera.frames - 100, "its reports no longer pass"
        for name, camera in self.lost.items():
            if name not in self.cameras and name in members:
                reason = members[name].lost
                assert reason
                assert not camera.has_left or reason == LEFT
        assert {*members} <= {"gate", *self.cameras, *self.lost}
        for _ in range(2):
            self._check_burst()
        for number in range(3):
            self.kill(number)
        self.wait(4)
        self.sent.clear()
        self.wait(0)
        assert not self.sent["MemberReports"], "the root knows that they are lost"

    def _check_burst(self) -> None:
        if not self.cameras:
            return
        list(iter(self.root.next_event, None))
        self.triggers = {name: [] for name in NAMES}
        burst = self.root.trigger(self.now_ns, BurstOrder(frames=3))
        assert {*burst.clients} == {*self.cameras}
        self.sent.clear()
        self.wait(0)
        assert self.sent["TriggerAck"] <= 2 * len(
            {camera.state == "ready" for camera in self.cameras.values()}
        )
        answers = [event for event in iter(self.root.next_event, None) if isinstance(event, TriggerAnswered)]
        expected = {name: "" if camera.state == "ready" else "no" for name, camera in self.cameras.items()}
        assert {answer.name: answer.refusal for answer in answers} == expected
        assert len(answers) == len(expected)
        for name in self.cameras:
            assert self.triggers[name]
            assert all(one == other for one, other in pairwise(self.triggers[name]))
            assert len(self.triggers[name]) <= 2, "it is told on and on"


USUAL = ("join", "wait", "change")
OTHERS = ("kill", "restart", "sign_off", "lose_messages", "restart_root")


@settings(max_examples=25)
@given(histories(USUAL, OTHERS, max_others=3, max_steps=14, numbers=15))
def test_the_root_soon_knows_each_camera_below_a_relay(history: list[tuple[str, int]]) -> None:
    world = World()
    for step, number in history:
        getattr(world, step)(number)
    world.check()
