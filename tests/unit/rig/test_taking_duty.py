"""What a series of takes owes who watches it, in series that are drawn.

Each take that is ordered begins and ends once, in their order; a failure ends what it should; nobody is asked
for more than the plan says, at no other time, and nothing runs on.
"""

import asyncio
import random
from collections import defaultdict
from collections.abc import AsyncIterator, Iterator
from itertools import pairwise
from typing import Any, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.common.errors import DiskFullError
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.orders import CancelBurst, EndBurst
from capture_app.protocol.status import BurstStatus
from capture_app.rig.taking import (
    Begun,
    Countdown,
    Failed,
    Progress,
    Saved,
    TakeEvent,
    TakePlan,
    Taking,
    Waiting,
)
from tests.virtual.in_process import virtual_loop

READY_S = 5.0
"""Time after which the leader's rig is ready."""


class Link:
    """A leader that takes so long for each take as is drawn, or fails."""

    def __init__(self, drawn: random.Random) -> None:
        self._drawn = drawn
        self.now = asyncio.get_running_loop().time
        self.ordered: list[tuple[float, BurstRequest]] = []
        self.begun_s: list[float] = []
        self.over_s: list[float] = []
        self.failed: list[int] = []
        self.told: list[EndBurst | CancelBurst] = []

    async def burst(self, request: BurstRequest) -> AsyncIterator[BurstStatus]:
        self.ordered.append((self.now(), request))
        number = len(self.ordered)
        status: dict[str, Any] = {"cameras": 1, "instants": 1, "received": 0, "expected": 1}
        if request.wait_ready_s:
            yield BurstStatus(burst=0, name="", message="waits", **status)
            await asyncio.sleep(READY_S)
        if self._drawn.random() < 0.2:
            self.failed.append(number)
            self.over_s.append(self.now())
            raise DiskFullError("the disk is full", hint="make room")
        self.begun_s.append(self.now())
        for _ in range(self._drawn.randrange(3)):
            yield BurstStatus(burst=number, name=f"burst-{number}", **status)
            await asyncio.sleep(self._drawn.choice([0.0, 0.5, 4.0]))
        status["received"] = 1
        self.over_s.append(self.now())
        yield BurstStatus(
            burst=number, name=f"burst-{number}", done=True, session=f"/gone/{number}", **status
        )

    async def order(self, order: EndBurst | CancelBurst) -> None:
        self.told.append(order)


def check_events(events: list[TakeEvent], plan: TakePlan) -> None:
    """Each take's events are in their order, and end once."""
    by_number = defaultdict[int, list[TakeEvent]](list)
    for event in events:
        by_number[event.number].append(event)
    assert [*by_number] == sorted(by_number)
    assert len(by_number) <= plan.repeat
    for of in by_number.values():
        kinds = [type(event) for event in of]
        order = (Countdown, Waiting, Begun, Progress)
        places = [order.index(kind) for kind in kinds if kind in order]
        assert places == sorted(places)
        assert kinds.count(Begun) <= 1
        ends = [kind for kind in kinds if kind in (Saved, Failed)]
        assert kinds[len(kinds) - len(ends) :] == ends, "it goes on after its end"
        assert len(ends) <= 1
        seconds = [event.seconds for event in of if isinstance(event, Countdown)]
        assert seconds == sorted({*seconds}, reverse=True)


async def happen(seed: int) -> None:
    drawn = random.Random(seed)
    plan = TakePlan(
        frames=1,
        repeat=drawn.randint(1, 4),
        every_s=drawn.choice([None, None, 1.0, 3.0]),
        countdown_s=drawn.choice([0.0, 0.0, 2.5]),
        wait_ready_s=drawn.choice([0.0, 20.0]),
    )
    link = Link(drawn)
    began_s = link.now()
    taking, events = Taking(cast(Any, link), plan), list[TakeEvent]()
    does, after = drawn.choice(["", "", "stop", "take_now", "end", "cancel"]), drawn.randrange(5)
    done_s: float | None = None
    active: list[int] = []
    async for event in taking:
        events.append(event)
        if does and len(events) > after and done_s is None:
            done_s = link.now()
            over = {e.number for e in events if isinstance(e, Saved | Failed)}
            active = [n for n, status in taking._active.items() if n not in over]
            if (result := getattr(taking, does)()) is not None:
                await result
    assert len(asyncio.all_tasks()) == 1, "something runs on"
    assert not taking.is_open
    assert not taking.is_waiting
    check_events(events, plan)
    times = [at_s for at_s, request in link.ordered]
    assert times[0] >= began_s + plan.countdown_s if times else does
    is_stopped = does in ("stop", "end", "cancel") and done_s is not None
    if is_stopped and done_s is not None:
        assert not [at_s for at_s in times if at_s > done_s], "it takes on"
    told = {"end": EndBurst, "cancel": CancelBurst}.get(does)
    expected = [] if told is None or done_s is None else [told(burst=taken) for taken in active]
    assert [type(order) for order in link.told] == [type(order) for order in expected]
    if is_stopped or does == "take_now":
        if does == "take_now" and done_s is not None:
            assert not [r for at_s, r in link.ordered if at_s > done_s and r.wait_ready_s], "it waits again"
        return
    ends = [event for event in events if isinstance(event, Saved | Failed)]
    assert len(ends) == len(link.ordered) == len(link.over_s)
    assert {event.number for event in ends if isinstance(event, Failed)} == {*link.failed}
    if plan.every_s is None:
        assert all(
            at_s >= over_s + plan.countdown_s for at_s, over_s in zip(times[1:], link.over_s, strict=False)
        )
        last = min(link.failed, default=plan.repeat)
    else:
        last = 1 if link.failed[:1] == [1] else plan.repeat
        assert all(abs(b - a - plan.every_s) < 0.01 for a, b in pairwise(times) if not plan.wait_ready_s)
    assert len(times) == last, "the series ends too early, or too late"


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    loop = virtual_loop()
    yield loop
    loop.close()


@given(st.integers(0, 2**32))
@settings(max_examples=150)
def test_each_take_of_a_series_begins_and_ends_once(loop: asyncio.AbstractEventLoop, seed: int) -> None:
    loop.run_until_complete(happen(seed))


@pytest.mark.virtual
async def test_a_fault_of_the_program_is_raised_and_leaves_nothing_running() -> None:
    class Broken(Link):
        async def burst(self, request: BurstRequest) -> AsyncIterator[BurstStatus]:
            if self.ordered:
                raise RuntimeError("a fault of this program")
            async for status in super().burst(request):
                yield status

    plan = TakePlan(frames=1, repeat=3, every_s=0.1)
    with pytest.raises(RuntimeError, match="a fault of this program"):
        async for _ in Taking(cast(Any, Broken(random.Random(2))), plan):
            pass
    assert asyncio.all_tasks() == {asyncio.current_task()}
