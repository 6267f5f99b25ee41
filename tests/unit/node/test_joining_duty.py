"""What a node's search for its leaders owes it, in histories that are drawn, in virtual time.

A lost leader is found again by its key wherever it is announced or was before, and no other one is taken for
it; a key is asked for until it is there, and never in haste.
"""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from typing import Any, cast
from unittest.mock import AsyncMock, Mock, patch

import pytest
from hypothesis import given, settings

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, UnknownMachineError
from capture_app.node import joining
from capture_app.node.joining import KEY_AGAIN_S, Joining
from capture_app.protocol.log import Log
from capture_app.protocol.messages import KeyAnswer
from capture_app.protocol.pairing_messages import FoundLeader
from capture_app.sync.rig.failover import LeaderChoice
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.datagrams import RigConfigMessage
from capture_app.trust.trust import Trust
from tests.histories import histories
from tests.virtual.in_process import virtual_loop

PLACES = tuple(Address(f"10.0.0.{n}", 47010) for n in range(1, 5))
OWN, OTHER, REFUSING = 7, 8, 9
"""Instances of the leader that the node follows, of another rig's, and of one that lets it in nowhere."""
FOUND_S = 20


class World:
    """An open rig: which leader runs at which address, and which addresses are announced."""

    def __init__(self) -> None:
        self.at: dict[Address, int] = {PLACES[0]: OWN}
        self.announced: dict[Address, int] = {PLACES[0]: OWN}
        self.said: list[str] = []
        self.pump = Mock()
        self.stored: list[Mapping[str, tuple[Address, ...]]] = []
        self.client = TimeClient("cam", 1, Timekeeper(1))
        self.choice = LeaderChoice(PLACES[:1], self.client)
        self.followed: dict[str, set[Address]] = {}
        """Where each leader was followed for some seconds."""
        self.looks = 0
        self.announced_s = 0.0
        """How long the followed leader is announced."""
        self.browsers = 0
        self.joining = Joining(
            self.choice,
            Mock(),
            self.pump,
            Trust.open(),
            Log(self._say),
            PLACES[:1],
            remember=self._store,
        )

    def _say(self, text: str) -> None:
        self.said.append(text)
        assert "is now at" in text or not self.client.is_member, "nothing is in the way"

    def _store(self, followed: Mapping[str, tuple[Address, ...]]) -> None:
        if self.stored and [*followed][-1] != [*self.stored[-1]][-1] == str(OWN):
            assert self.announced_s < 3, "it takes another one for its own, which is announced elsewhere"
        self.stored.append(followed)

    @contextmanager
    def entered(self) -> Iterator[None]:
        world = self

        class Browser:
            """What is announced now."""

            async def __aenter__(self) -> "Browser":
                world.browsers += 1
                return self

            async def __aexit__(self, *_: object) -> None:
                world.browsers -= 1

            async def refresh(self) -> None: ...

            @property
            def found(self) -> Sequence[FoundLeader]:
                leaders = {key: [p for p, of in world.announced.items() if of == key] for key in (OTHER, OWN)}
                return [FoundLeader(str(key), tuple(at), key=str(key)) for key, at in leaders.items() if at]

        with (
            patch.object(joining, "LeaderBrowser", Browser),
            patch.object(joining, "proves_key", self._proves),
            patch.object(joining, "find_obstacle", self._obstacle),
            patch.object(joining, "power_saving_towards", lambda host: ""),
        ):
            yield

    async def _proves(self, place: Address, key: str, trust: Trust) -> bool:
        await asyncio.sleep(0.1)
        return str(self.at.get(place)) == key

    async def _obstacle(self, place: Address) -> Any:
        await asyncio.sleep(0.3)
        return None if place in self.at else Mock(what="off", __str__=lambda _: f"{place.host} is off")

    async def run_network(self) -> None:
        """Join whatever leader is at the address, and ask in vain where none is."""
        while True:
            place = Address(*self.choice.leader)
            leader = self.at.get(place)
            if self.client.is_member and (
                self.client.followed is None or leader != self.client.followed.leader
            ):
                self.client.number = None
            if leader is None:
                self.client.unanswered += 1
            elif leader == REFUSING:
                self.client.unanswered = 0
            elif self.client.is_member:
                self.looks += 1
                if self.looks > 8:
                    self.followed.setdefault(str(leader), set()).add(place)
            else:
                self.client.number, self.client.unanswered, self.looks = 1, 0, 0
                self.client.followed = RigConfigMessage(leader=leader, anchor_leader_ns=0, period_ns=10**7)
            self.choice.update(0)
            await asyncio.sleep(0.5)
            self.announced_s = self.announced_s + 0.5 if OWN in self.announced.values() else 0.0

    # What happens

    def _place(self) -> Address | None:
        return next((place for place, of in self.at.items() if of == OWN), None)

    async def move(self, number: int) -> None:
        """The leader has another address from now on, and is announced there a little later, or never."""
        place = self._place()
        if place is not None and (new := PLACES[number % 4]) not in self.at:
            del self.at[place]
            self.at[new] = OWN
            self.announced.pop(place, None)
            if number > 3:
                await asyncio.sleep(number % 3)
                self.announced[new] = OWN

    async def stop(self, number: int) -> None:
        if (place := self._place()) is not None:
            del self.at[place]
            self.announced.pop(place, None)

    async def start(self, number: int) -> None:
        if self._place() is None and (new := PLACES[number % 4]) not in self.at:
            self.at[new] = self.announced[new] = OWN

    async def start_other(self, number: int) -> None:
        """Another rig's leader has an address, perhaps the one that the node knows."""
        if (place := PLACES[number % 4]) not in self.at and {*self.at.values()} <= {OWN}:
            self.at[place] = self.announced[place] = OTHER if number < 6 else REFUSING

    async def stop_other(self, number: int) -> None:
        for place in [place for place, of in self.at.items() if of != OWN]:
            del self.at[place]
            del self.announced[place]

    async def wait(self, number: int) -> None:
        await asyncio.sleep((0.1, 1, 3, 10, 30)[number % 5])

    # What must be true

    async def check(self) -> None:
        """Whoever is remembered last is followed wherever it is announced, or was followed before."""
        await asyncio.sleep(FOUND_S)
        remembered = self.stored[-1] if self.stored else {}
        newest = ["", *remembered][-1]
        place = next((place for place, of in self.at.items() if str(of) == newest), None)
        followed = self.client.followed
        is_known = place is not None and (place in self.announced or place in remembered[newest])
        if is_known:
            assert self.client.is_member
            assert followed is not None
            assert str(followed.leader) == newest
            assert Address(*self.choice.leader) == place
        if self.client.is_member:
            assert followed is not None
            assert newest == str(followed.leader), "it would follow another one when it is started again"
            assert remembered[newest][-1] == self.choice.leader
            assert self.browsers == 0, "it searches on"
        for key, places in self.followed.items():
            assert places <= {*remembered[key]}, "it could be there again"
        moves = [line for line in self.said if "is now at" in line]
        assert self.pump.turn.call_count == len(moves), "its hello waits"
        for first, second in zip(self.said, self.said[1:], strict=False):
            assert first != second, "it is said again"


USUAL = ("move", "wait", "stop", "start")
OTHERS = ("start_other", "stop_other")


async def happen(world: World, history: list[tuple[str, int]]) -> None:
    with world.entered():
        tasks = [asyncio.create_task(work) for work in (world.run_network(), world.joining.watch())]
        await asyncio.sleep(1)
        for step, number in history:
            await getattr(world, step)(number)
        await world.check()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    loop = virtual_loop()
    yield loop
    loop.close()


@given(histories(USUAL, OTHERS, max_steps=16, numbers=8))
@settings(max_examples=40)
def test_a_leader_is_found_again_by_its_key(
    loop: asyncio.AbstractEventLoop, history: list[tuple[str, int]]
) -> None:
    loop.run_until_complete(asyncio.wait_for(happen(World(), history), 600))


class Keys:
    """A node's keys, which miss one whenever the node has something to say to a leader without."""

    def __init__(self) -> None:
        self.missing: set[tuple[str, int]] = set()
        self.grants: dict[tuple[str, int], object] = {}

    def hold(self, leader: tuple[str, int], grant: object) -> None:
        self.grants[leader] = grant
        self.missing.discard(leader)


class Streams:
    """Leaders that are asked for keys: quick, slow, dead, or one that does not know this machine."""

    def __init__(self) -> None:
        self.keys, self.client = Keys(), TimeClient("cam", 9, Timekeeper(1))
        self.asked: dict[Address, list[float]] = {place: [] for place in PLACES}
        self.closed = Counter[Address]()
        self.trust = Mock(is_open=False)
        self.pump, self.enrol = Mock(), AsyncMock()
        self.succession: Any = None
        self.joining: Joining

    def begin(self, succession: Any = None) -> None:
        choice, keys = LeaderChoice(PLACES, self.client), cast(Any, self.keys)
        self.joining = Joining(choice, keys, self.pump, self.trust, Log(), succession=succession)

    async def connect(self, place: Address, *_: object, **__: object) -> Any:
        now_s = asyncio.get_running_loop().time()
        self.asked[place].append(now_s)
        if place == PLACES[1]:
            await asyncio.sleep(5)
        if place == PLACES[2]:
            raise NetworkError("nobody answers", hint="")
        if place == PLACES[3]:
            raise UnknownMachineError("the leader does not know this machine", hint="")
        return self._channel(place)

    @asynccontextmanager
    async def _channel(self, place: Address) -> AsyncIterator[Any]:
        yield Mock(place=place, who=Mock(pin=f"pin of {place.host}"))
        self.closed[place] += 1

    async def ask(self, channel: Any, request: Any, kind: object) -> Any:
        assert (request.name, request.instance, request.is_relay) == ("cam", 9, False)
        return Mock(spec=KeyAnswer, grant=f"for {channel.place}", machines=("m",), names={"a": "b"})

    async def need(self, seconds: float) -> None:
        """Have something to say, twenty times a second, to each leader whose key is not there."""
        for _ in range(round(seconds * 20)):
            self.keys.missing |= {place for place in PLACES if place not in self.keys.grants}
            self.joining.look(5)
            await asyncio.sleep(0.05)


@pytest.mark.virtual
@pytest.mark.parametrize("followed", [None, PLACES[0], PLACES[1]])
async def test_a_key_is_asked_for_until_it_is_there_and_not_in_haste(followed: Address | None) -> None:
    streams = Streams()
    streams.begin(None if followed is None else Mock(leader=followed))
    with (
        patch.object(joining, "connect", streams.connect),
        patch.object(joining, "ask", streams.ask),
        patch.object(joining, "ask_to_enrol", streams.enrol),
    ):
        running = asyncio.create_task(streams.joining.run())
        await streams.need(4.0)
        assert streams.keys.grants == {PLACES[0]: f"for {PLACES[0]}"}, "a slow leader keeps no other waiting"
        assert [len(streams.asked[place]) for place in PLACES[:2]] == [1, 1]
        for place in PLACES[2:]:
            assert 4.0 / KEY_AGAIN_S / 2 <= len(streams.asked[place]) <= 4.0 / KEY_AGAIN_S + 1
        assert streams.client.why_joining == "the leader does not know this machine", "not that one is dead"
        assert [call.args for call in streams.enrol.await_args_list] == (
            [(PLACES[3], streams.trust)] * len(streams.asked[PLACES[3]])
        ), "this machine may have been added there"
        await streams.need(2.0)
        assert streams.keys.grants.keys() == {*PLACES[:2]}
        vouching = [call.args[0].pin for call in streams.trust.take_trust_of.call_args_list]
        assert vouching == [f"pin of {at.host}" for at in PLACES[:2] if followed in (None, at)]
        assert all(
            call.args[1:] == (("m",), {"a": "b"}) for call in streams.trust.take_trust_of.call_args_list
        )
        assert streams.closed == {PLACES[0]: 1, PLACES[1]: 1}
        assert streams.pump.turn.call_count == 2, "what waited for the key is sent"
        asked = [len(times) for times in streams.asked.values()]
        for _ in range(20):
            streams.joining.look(5)
            await asyncio.sleep(0.1)
        assert sum(map(len, streams.asked.values())) <= sum(asked) + 2, "nobody needs another key"
        streams.joining.ask_again(PLACES[0])
        await asyncio.sleep(1)
        assert len(streams.asked[PLACES[0]]) == 2
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
