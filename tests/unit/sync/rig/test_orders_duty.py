"""What a leader's orders of bursts owe its cameras, in histories that are drawn.

Each camera of a burst is told until it answers or is given up, always what was ordered last, and each answer
is reported once; the rig is busy until the last burst is over.
"""

import random
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given, settings
from msgspec import structs

from capture_app.common.errors import NoCameraHereError, SimulshotError
from capture_app.common.node_state import CLOCK_ONLY, NodeState
from capture_app.common.timeouts import TRIGGER_GIVE_UP_NS
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.rig.burst_orders import (
    AFTER_BURST_NS,
    CANCELLED,
    MAX_LEAD_NS,
    NO_ANSWER,
    TRIGGER_AGAIN_NS,
    BurstOrder,
    Orders,
)
from capture_app.sync.rig.events import TriggerAnswered
from capture_app.sync.rig.frame_selection import MAX_BURST_NS, MAX_FRAMES, Burst
from capture_app.sync.rig.roster import Roster
from capture_app.sync.timekeeping.poll_schedule import NEVER_NS
from capture_app.sync.wire.datagrams import Hello, Report, TriggerAck
from tests.facts import make_facts
from tests.histories import histories

LEADER, EARLIER_RUN, PERIOD_NS = 7, 6, 40_000_000
S = 10**9
CAMERA = make_facts(period_ns=PERIOD_NS)
NAMES = ("a", "b", "c")
READY = Report(state=NodeState.READY)


@dataclass
class Ordered:
    """A burst as it was ordered last."""

    burst: Burst
    run: int
    count: int
    is_first: bool
    """Whether its cameras are told of it for the first time: their answers are reported."""
    unanswered: set[str] = field(default_factory=set)
    give_up_ns: int = 0
    busy_until_ns: int = 0
    told_ns: dict[str, int] = field(default_factory=dict)
    """When each camera was told last."""
    lost: list[str] = field(default_factory=list)
    """Cameras that were lost before they answered; one that returns has another number."""


class Duty:
    """A leader's orders and their cameras; each method is something that happens."""

    def __init__(self) -> None:
        self.roster = Roster(random.Random(1))
        self.now_ns = 100 * S
        self.grid = FrameGrid(5, PERIOD_NS)
        for name in (*NAMES, "clock"):
            self._join(name)
        self.orders = Orders(LEADER, self.roster)
        self.bursts: dict[tuple[int, int], Ordered] = {}

    def _join(self, name: str) -> None:
        camera = structs.replace(CAMERA, kind=CLOCK_ONLY) if name == "clock" else CAMERA
        member, _ = self.roster.admit(Hello(name, 1, camera), (name, 1), self.now_ns)
        self.roster.confirm(member)
        member.report = READY

    def _here(self, burst: Burst) -> set[str]:
        return {name for name in burst.clients if not self.roster.members[name].lost}

    def _note(self, burst: Burst, run: int, count: int, *, is_first: bool = False) -> None:
        key = run, burst.number
        self.bursts[key] = Ordered(
            burst,
            run,
            count,
            is_first,
            self._here(burst),
            self.now_ns + TRIGGER_GIVE_UP_NS,
            max(self.now_ns, burst.instants_ns[-1] + PERIOD_NS) + AFTER_BURST_NS,
        )

    def _own(self, number: int) -> Ordered | None:
        own = [of for of in self.bursts.values() if of.run == LEADER and of.count]
        return own[number % len(own)] if own else None

    def place(self, number: int) -> None:
        order = BurstOrder(
            frames=3, spacing=1 + number % 2, spare=2, streamed=number > 2, video=number > 3,
            without=("b",) if number == 1 else (),
        )  # fmt: skip
        if not any(name not in order.without and not self.roster.members[name].lost for name in NAMES):
            return
        burst = self.orders.place(self.grid, self.now_ns, order)
        assert (LEADER, burst.number) not in self.bursts
        assert {*burst.clients} == {
            name for name in NAMES if name not in order.without and not self.roster.members[name].lost
        }
        assert burst.instants_ns[0] > self.now_ns, "no camera can know of it by then"
        assert self.grid.phase_error(burst.instants_ns[0]) == 0
        assert burst.step_ns == order.spacing * PERIOD_NS
        assert (burst.frames, burst.spare) == (3, 0 if order.streamed else 2)
        self._note(burst, LEADER, len(burst.instants_ns), is_first=True)

    def place_impossible(self, number: int) -> None:
        at_ns = self.now_ns + (MAX_LEAD_NS + 1) * (-1 if number % 2 else 1)
        for order in (
            BurstOrder(frames=0),
            BurstOrder(frames=1, spacing=0),
            BurstOrder(frames=MAX_FRAMES + 1),
            BurstOrder(frames=2, spacing=MAX_BURST_NS // PERIOD_NS + 1),
            BurstOrder(frames=1, at_leader_ns=at_ns),
        ):
            with pytest.raises(SimulshotError):
                self.orders.place(self.grid, self.now_ns, order)
        for grid, without in ((None, ()), (self.grid, NAMES)):
            with pytest.raises(NoCameraHereError):
                self.orders.place(grid, self.now_ns, BurstOrder(frames=1, without=without))

    def end(self, number: int) -> None:
        of = self._own(number)
        if of is not None and of.burst.streamed:
            ended = self.orders.end(of.burst, 1 + number % 3, self.now_ns)
            assert ended == replace(of.burst, instants_ns=of.burst.instants_ns[: 1 + number % 3])
            self._note(ended, LEADER, ended.frames)

    def cancel(self, number: int) -> None:
        if (of := self._own(number)) is not None:
            self.orders.cancel(of.burst, self.now_ns)
            self._note(of.burst, LEADER, 0)

    def resume(self, number: int) -> None:
        """A recording of the leader's earlier run goes on, at the cameras that are ready."""
        instants_ns = range(self.now_ns + 5 - self.now_ns % PERIOD_NS, self.now_ns + 4 * S, PERIOD_NS)
        burst = Burst(
            900 + number, instants_ns, PERIOD_NS, instants_ns[0], NAMES[:2], streamed=True, video=True
        )
        self.orders.resume(burst, EARLIER_RUN, self.now_ns)
        self._note(burst, EARLIER_RUN, len(instants_ns))
        of = self.bursts[EARLIER_RUN, burst.number]
        of.unanswered &= {name for name in NAMES if self.roster.members[name].report.state.is_aligned}

    def answer(self, number: int) -> None:
        """A camera answers each order; a late one is to what was ordered before."""
        name, member = NAMES[number % 3], self.roster.members[NAMES[number % 3]]
        if member.lost:
            return
        for of in self.bursts.values():
            cancels, refusal = not of.count, "its clock" if number > 3 else ""
            if cancels and number < 3:
                refusal = CANCELLED
            ack = TriggerAck(member.number, of.run, of.burst.number, refusal)
            answer = self.orders.take_ack(member, ack)
            is_told = name in of.unanswered and not (cancels and refusal != CANCELLED)
            if is_told:
                of.unanswered.discard(name)
            if is_told and of.is_first:
                assert answer == TriggerAnswered(name, of.burst.number, refusal)
            else:
                assert answer is None
        assert self.orders.take_ack(member, TriggerAck(member.number, LEADER + 9, 1)) is None

    def lose(self, number: int) -> None:
        member = self.roster.members[NAMES[number % 3]]
        if not member.lost:
            self.roster.mark_lost(member, "silent")
            for of in self.bursts.values():
                if member.name in of.unanswered:
                    of.unanswered.discard(member.name)
                    of.lost.append(member.name)

    def come_back(self, number: int) -> None:
        """A camera that was started again, or was away, is ready."""
        name = NAMES[number % 3]
        if self.roster.members[name].lost:
            self._join(name)
        else:
            self.roster.members[name].report = READY
        self.orders.order_again(self.roster.members[name], self.now_ns)
        for of in self.bursts.values():
            is_streamed = of.burst.streamed and of.count and self.now_ns < of.burst.instants_ns[-1]
            if is_streamed and name in of.burst.clients:
                if not (of.unanswered or of.lost):
                    of.give_up_ns, of.is_first = self.now_ns + TRIGGER_GIVE_UP_NS, False
                of.unanswered.add(name)
                of.told_ns.clear()

    def align(self, number: int) -> None:
        """A camera's stream is being moved."""
        if not (member := self.roster.members[NAMES[number % 3]]).lost:
            member.report = Report(state=NodeState.ALIGNING)

    def wait(self, number: int) -> None:
        self.now_ns += (TRIGGER_AGAIN_NS // 2, TRIGGER_AGAIN_NS, S, TRIGGER_GIVE_UP_NS, 5 * S, 30 * S)[number]

    def handle_timer(self) -> None:
        due_ns = self.orders.next_timer()
        given_up = self.orders.expire(self.now_ns)
        expected: list[TriggerAnswered] = []
        for of in self.bursts.values():
            told_ns = max(of.told_ns.values(), default=0)
            is_due = self.now_ns >= min(told_ns + TRIGGER_AGAIN_NS, of.give_up_ns)
            lost_names, of.lost = (of.lost, []) if is_due else ([], of.lost)
            silent_names = [*of.unanswered] if self.now_ns >= of.give_up_ns else []
            of.unanswered -= {*silent_names}
            for names, why in ((lost_names, "silent"), (silent_names, NO_ANSWER)):
                for name in names:
                    if of.is_first:
                        expected.append(TriggerAnswered(name, of.burst.number, why, is_silent=True))
        assert sorted(given_up, key=str) == sorted(expected, key=str)
        told = {key: set[str]() for key in self.bursts}
        for members, trigger in self.orders.triggers_due(self.now_ns):
            of = self.bursts[trigger.leader, trigger.burst]
            assert trigger.count == of.count
            assert trigger.root == (0 if of.run == LEADER else LEADER)
            assert trigger.first_leader_ns == of.burst.instants_ns[0]
            if of.count:
                burst = of.burst
                assert burst.frames == 1 or trigger.step_ns == burst.step_ns
                assert (trigger.spare, trigger.streamed, trigger.video) == (
                    burst.spare, burst.streamed, burst.video,
                )  # fmt: skip
            told[trigger.leader, trigger.burst] |= {member.name for member in members}
        for key, of in self.bursts.items():
            if told[key]:
                assert max(of.told_ns.values(), default=0) <= self.now_ns - TRIGGER_AGAIN_NS, "it is too soon"
                assert told[key] == of.unanswered, "who has answered is not asked again, and all others are"
                assert due_ns <= self.now_ns, "nobody would have woken up"
                of.told_ns = dict.fromkeys(of.unanswered, self.now_ns)
            for name in of.unanswered:
                assert of.told_ns[name] > self.now_ns - TRIGGER_AGAIN_NS, "it is not told again"
        assert (self.orders.next_timer() < NEVER_NS) == any(
            of.unanswered or of.lost for of in self.bursts.values()
        )

    def check(self) -> None:
        self.handle_timer()
        is_busy = any(self.now_ns < of.busy_until_ns for of in self.bursts.values() if of.count)
        assert self.orders.is_busy(self.now_ns) == is_busy


USUAL = ("place", "wait", "answer")
OTHERS = ("end", "cancel", "lose", "come_back", "align", "resume", "place_impossible")


@settings(max_examples=200)
@given(histories(USUAL, OTHERS, max_others=3))
def test_each_camera_is_told_what_was_ordered_last_until_it_answers(history: list[tuple[str, int]]) -> None:
    duty = Duty()
    for step, number in history:
        getattr(duty, step)(number)
        duty.check()
