"""What a leader owes its operator of takes, in orders that are drawn.

Each take has a number and a folder of its own; what is under way or ahead is listed until it is over, and
bounded; an end or a cancellation concerns the named take alone, and each camera learns of it.
"""

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from msgspec.structs import replace

from capture_app.common.errors import BadInputError, IncompleteError, UnwantedImageError
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.leader import bursts as leader_bursts
from capture_app.node.leader.bursts import END_LEAD_NS, SOON_NS, ActiveBursts
from capture_app.session.format.burst_plan import MissingRun
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.leader_engine import Leader
from capture_app.sync.wire.datagrams import TimeRequest
from tests.histories import histories
from tests.unit.node.bursts import IMAGE, LEADER, pieces, receive_image, report, upload
from tests.unit.node.leader.test_active_bursts import NOW_NS, StillClock, bursts_of, engine_of, triggers_sent
from tests.virtual.in_process import virtual_loop

S = 10**9
NAMES = ("a", "b")
MAX_OPEN, MAX_AHEAD = 3, 2


@dataclass
class Take:
    """A take as its operator knows it."""

    session: BurstSession
    folder: Path
    frames: int
    """Instants that its cameras were ordered to take, without the spare ones."""
    streamed: bool
    is_over: bool = False
    is_cancelled: bool = False


class Operator:
    """An operator at a leader with two cameras; each method is something that happens."""

    def __init__(self, bursts: ActiveBursts, engine: Leader) -> None:
        self.bursts, self.engine = bursts, engine
        self.takes: dict[int, Take] = {}
        """All takes, by number."""
        self.counts: dict[int, int] = {}
        """Length of each take in the last trigger that was sent."""

    @property
    def now_ns(self) -> int:
        return self.bursts.now_ns()

    def open(self, *, ahead: bool) -> list[int]:
        soon_ns = self.now_ns + SOON_NS
        return [
            number
            for number, take in self.takes.items()
            if not take.is_over and (take.session.burst.instants_ns[0] > soon_ns) == ahead
        ]

    async def order(self, number: int) -> None:
        """Order stills, a long burst, a recording, or stills in a minute."""
        at_ns = self.now_ns + 60 * S if number == 3 else None
        streamed = number in (1, 2)
        asked = BurstOrder(
            frames=2 if not streamed else 500,
            spare=4,
            at_leader_ns=at_ns,
            streamed=streamed,
            video=number == 2,
        )
        is_refused = len(self.open(ahead=False)) >= MAX_OPEN or (
            number == 3 and len(self.open(ahead=True)) >= MAX_AHEAD
        )
        try:
            session = await self.bursts.order(asked)
        except IncompleteError:
            assert is_refused, "there is room for it"
            return
        assert not is_refused, "there are too many"
        burst = session.burst
        assert burst.number > max(self.takes, default=0), "a number is used again"
        assert session.folder not in {take.folder for take in self.takes.values()}
        assert session.folder.name.startswith("recording-" if number == 2 else "burst-")
        assert self.bursts.newest is session
        self.takes[burst.number] = Take(session, session.folder, burst.frames, streamed)

    async def cancel(self, number: int) -> None:
        take = self.takes.get(number)
        if take is None or take.is_over:
            with pytest.raises(BadInputError):
                await self.bursts.cancel(number)
            return
        await self.bursts.cancel(number)
        take.is_over = take.is_cancelled = True
        assert "cancelled" in take.session.message or take.session.session is None

    async def end(self, number: int) -> None:
        """End a take by its number, or with 0 the newest recording."""
        under_way = [n for n, take in self.takes.items() if take.streamed and not take.is_over]
        ended = number if number in under_way else under_way[-1] if not number and under_way else 0
        if number and not ended and number in self.takes and self.takes[number].is_over:
            await self.bursts.end(number)  # It was over before its operator knew.
        elif not ended:
            with pytest.raises(BadInputError):
                await self.bursts.end(number or None)
        else:
            take = self.takes[ended]
            await self.bursts.end(number or None)
            until_ns = self.now_ns + END_LEAD_NS
            passed = sum(at_ns <= until_ns for at_ns in take.session.burst.instants_ns)
            take.frames = min(take.frames, max(1, passed))
            assert take.session.burst.frames == take.frames

    async def wait(self, number: int) -> None:
        self.bursts._options.clock.shown_ns += (1 + number * number) * S  # type: ignore[attr-defined]
        for name in NAMES:
            member = self.engine.roster.members[name]
            self.engine.receive_message(TimeRequest(member.number, 0, 0), (name, 0), self.now_ns)

    async def deliver(self, number: int) -> None:
        """Both cameras deliver all of a take, if its instants have passed."""
        take = self.takes.get(number)
        if take is None or take.is_over or self.now_ns < take.session.burst.instants_ns[-1] + S:
            return
        for name in NAMES:
            told = replace(report(name, *(() if take.streamed else (0, 1))), burst=number)
            if take.streamed:
                runs = (
                    (MissingRun(first=1, count=take.frames - 1, reason="dropped"),) if take.frames > 1 else ()
                )
                told = told.with_plan(instants=(0,), picked=take.frames, missing_runs=runs)
            session = await self.bursts.find_session(told, "")
            assert session is take.session
            await take.session.accept_report(told, self.now_ns)
        for name in NAMES:
            for instant in (0,) if take.streamed else (0, 1):
                image = replace(upload(name, instant), burst=number)
                await receive_image(take.session, image, pieces(IMAGE), self.now_ns)
        await asyncio.wait_for(take.session.finished.wait(), 60)
        await asyncio.sleep(0)
        take.is_over = True
        assert str(take.session.folder) in self.bursts.saved

    async def check(self) -> None:
        await asyncio.sleep(0)
        assert [burst.burst for burst in self.bursts.ahead] == self.open(ahead=True)
        assert [of.burst.number for of in self.bursts.under_way()] == self.open(ahead=False)
        for trigger in triggers_sent(self.engine, self.now_ns):
            take = self.takes[trigger.burst]
            ordered = 0 if take.is_cancelled else take.frames + trigger.spare
            assert trigger.count == ordered, "a camera is told something else"
            assert (trigger.leader, trigger.streamed) == (LEADER, take.streamed and not take.is_cancelled)
            self.counts[trigger.burst] = trigger.count
        for number, take in self.takes.items():
            assert (self.counts[number] == 0) == take.is_cancelled, "no camera has learned of it"
            assert take.session.folder == take.folder, "it is taken for another one's"
            if take.is_cancelled:
                with pytest.raises(UnwantedImageError):
                    await self.bursts.find_session(replace(report("a", 0), burst=number), "")


STEPS = ("order", "order", "wait", "deliver", "cancel", "end")


async def happen(root: Path, history: list[tuple[str, int]]) -> None:
    StillClock.shown_ns = NOW_NS
    engine = engine_of(*NAMES)
    async with bursts_of(root, engine) as bursts:
        operator = Operator(bursts, engine)
        for step, number in history:
            await getattr(operator, step)(number)
            await operator.check()


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    """One loop in virtual time for all histories, in which a leader has few takes at a time."""
    loop = virtual_loop()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(leader_bursts, "MAX_OPEN_BURSTS", MAX_OPEN)
        patch.setattr(leader_bursts, "MAX_BURSTS_AHEAD", MAX_AHEAD)
        yield loop
    loop.close()


@given(histories(STEPS, max_steps=16))
@settings(max_examples=40)
def test_each_take_is_numbered_listed_and_ended_by_itself(
    loop: asyncio.AbstractEventLoop, history: list[tuple[str, int]]
) -> None:
    with TemporaryDirectory() as root:
        loop.run_until_complete(happen(Path(root), history))
