"""What a leader owes the streams over which nodes deliver images, in histories that are drawn.

Each message has one answer, in order; a stream delivers its own camera's images of bursts that it reported;
a camera has one stream; and what a stream held is given back when it ends.
"""

import asyncio
import random
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import example, given, settings
from msgspec.structs import replace

from capture_app.common.errors import BadInputError, DiskFullError, TryAgainError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import UnreadableMessageError
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.service import LeaderService
from capture_app.protocol.messages import (
    CameraReport,
    ImageAck,
    ImageBatch,
    NodeStream,
    Refusal,
    ReportAck,
    SpoolSpace,
    StatusRequest,
)
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.wire.datagrams import Hello
from capture_app.trust.trust import Peer, Trust
from tests.histories import histories
from tests.unit.node.bursts import CAMERA, IMAGE, report, upload
from tests.unit.node.leader.fake_streams import FakeStream
from tests.virtual.in_process import virtual_loop

NAMES = ("a", "b")
NOW_NS = 7


class Session:
    """A burst's session, which counts its streams."""

    def __init__(self, number: int, memory: Counter[str]) -> None:
        self.number, self.streams, self.memory = number, Counter[str](), memory
        self.taken: list[ImageBatch] = []
        self.problem: Exception | None = None

    def stream_opened(self, camera: str) -> None:
        self.streams[camera] += 1

    def stream_closed(self, camera: str, now_ns: int) -> None:
        assert now_ns == NOW_NS
        self.streams[camera] -= 1

    async def accept_report(self, told: CameraReport, now_ns: int, *, wait_s: float) -> ReportAck:
        assert (told.burst, now_ns) == (self.number, NOW_NS)
        assert wait_s > 0
        return ReportAck(requested=(self.number,))

    async def take(
        self, batch: ImageBatch, payload: AsyncIterator[bytes], now_ns: int
    ) -> "asyncio.Future[str]":
        assert b"".join([piece async for piece in payload]) == IMAGE
        assert now_ns == NOW_NS
        assert self.memory[f"machine of {batch.camera}"] == batch.bytes
        if self.problem is not None:
            raise self.problem
        self.taken.append(batch)
        saving = asyncio.get_running_loop().create_future()
        asyncio.get_running_loop().call_later(0.1, saving.set_result, batch.sha256)
        return saving


class Bursts:
    """The bursts of a leader, of which number 3 is whole and number 4 nobody's."""

    def __init__(self) -> None:
        self.memory = Counter[str]()
        """What each machine's images have in memory at present."""
        self.all_sessions = list[Session]()
        self.sessions: dict[int, Session] = {}
        for number in range(3):
            self.begin(number)
        self.given_up: list[str] = []
        self.spools: list[SpoolSpace] = []
        self.progress: list[Session] = []

    def begin(self, number: int) -> None:
        self.sessions[number] = Session(number, self.memory)
        self.all_sessions.append(self.sessions[number])

    def now_ns(self) -> int:
        return NOW_NS

    async def give_up(self, camera: str, reason: str) -> None:
        assert reason.startswith("it sent an invalid message: ")
        self.given_up.append(camera)

    async def find_session(self, told: CameraReport, pin: str) -> Any:
        assert pin == f"pin of {told.camera}"
        if told.burst == 3:
            return ReportAck(requested=())
        if told.burst > 3:
            raise BadInputError("no session")
        return self.sessions[told.burst]

    def note_spool_space(self, space: SpoolSpace) -> None:
        self.spools.append(space)

    def report_progress(self, session: Any) -> None:
        self.progress.append(session)


class Stream(FakeStream):
    """A stream of a camera's node."""

    def __init__(self, name: str) -> None:
        super().__init__(f"machine of {name}")
        self.name, self.is_known = name, False
        self.who = Peer(pin=f"pin of {name}", name=name, roles=frozenset({Role.CAMERA}))
        self.expected: list[Any] = []
        self.reported: dict[int, Session] = {}
        self.is_opened = False
        self.is_named = False
        """Whether it has said whose it is."""
        self.task: asyncio.Task[None] | None = None

    async def receive_header(self) -> Any:
        if isinstance(message := await super().receive_header(), Exception):
            raise message
        return message


class Duty:
    """A leader's service and its nodes; each method is something that happens."""

    def __init__(self) -> None:
        engine = Leader(LeaderConfig(instance=77, transfer_port=1), random.Random(1))
        for name in NAMES:
            engine.receive_message(Hello(name, 5, CAMERA), (name, 0), 0)
        self.bursts = Bursts()
        other: Any = None
        self.service = LeaderService(
            LeaderOptions(sessions=Path(), trust=Trust.open()),
            engine,
            other,
            other,
            cast(Any, self.bursts),
            other,
            other,
            other,
        )
        self.service._memory._taken = self.bursts.memory
        self.given_up: list[str] = []
        self.streams: list[Stream] = []
        self.spaces: list[SpoolSpace] = []

    def _stream(self, number: int) -> Stream | None:
        here = [stream for stream in self.streams if stream.task is not None and not stream.task.done()]
        return here[number % len(here)] if here else None

    def connect(self, number: int) -> None:
        stream = Stream(NAMES[number % 2])
        stream.task = asyncio.create_task(self.service.serve(cast(Any, stream)))
        self.streams.append(stream)

    async def open(self, number: int) -> None:
        """A stream says whose it is; an earlier one of that camera is ended."""
        await self.rest()
        if (stream := self._stream(number)) is None:
            return
        instance = 6 if number == 5 else 5
        stream.say(NodeStream(camera=stream.name, instance=instance))
        if instance != 5:
            what = f"no node has joined as {stream.name} by this stream's key"
            stream.expected.append(Refusal.of_error(TryAgainError(what)))
            return
        stream.expected.append(ReportAck())
        stream.is_opened = stream.is_named = True
        for earlier in self.streams:
            if earlier is not stream and earlier.name == stream.name and earlier.is_opened:
                earlier.is_opened = False
        await self.rest()

    def report(self, number: int) -> None:
        if (stream := self._stream(number % 2)) is None:
            return
        stream.say(replace(report(stream.name, 0), burst=number))
        if not stream.is_opened:
            what = f"this stream may not send for camera {stream.name!r}"
            stream.expected.append(Refusal.of_error(BadInputError(what)))
        elif number > 3:
            stream.expected.append(Refusal.of_error(BadInputError("no session")))
        else:
            stream.expected.append(ReportAck(requested=() if number == 3 else (number,)))
            if number < 3:
                stream.reported[number] = self.bursts.sessions[number]

    def report_of_other(self, number: int) -> None:
        """A camera speaks for the other one."""
        if (stream := self._stream(number)) is not None:
            other = NAMES[1 - NAMES.index(stream.name)]
            stream.say(replace(report(other, 0), burst=1))
            what = f"this stream may not send for camera {other!r}"
            stream.expected.append(Refusal.of_error(BadInputError(what)))

    def images(self, number: int) -> None:
        if (stream := self._stream(number % 2)) is None:
            return
        batch = ImageBatch(images=(replace(upload(stream.name, 0), burst=number),))
        stream.say(batch, IMAGE)
        if (session := stream.reported.get(number)) is None:
            what = f"this stream may not send for camera {stream.name!r} in that burst"
            stream.expected.append(Refusal.of_error(BadInputError(what)))
        elif session.problem is not None:
            stream.expected.append(Refusal.of_error(cast(Any, session.problem)))
        else:
            stream.expected.append(ImageAck(sha256=batch.sha256))

    async def reopen(self, number: int) -> None:
        """A burst's session was finished, and is opened again for the next report."""
        await self.rest()
        self.bursts.begin(number % 3)

    async def nonsense(self, number: int) -> None:
        """A stream sends what is no message; the bursts go on without its camera."""
        if (stream := self._stream(number)) is None:
            return
        await self.rest()
        stream.say(UnreadableMessageError("no message"))
        if stream.is_named:
            stream.expected.append(Refusal(what=f"{stream.name} sent an invalid message: no message"))
            self.given_up.append(stream.name)
        await self.rest()
        assert stream.task is not None
        assert stream.task.done() is not stream.is_named
        if stream.task.done():
            assert isinstance(stream.task.exception(), UnreadableMessageError)

    async def stranger(self, _: int) -> None:
        """A machine that nobody knows has its answer, and may not stay."""
        stream = Stream("nobody")
        stream.who = Peer()
        stream.task = asyncio.create_task(self.service.serve(cast(Any, stream)))
        stream.say(StatusRequest())
        stream.say(StatusRequest())
        await asyncio.sleep(1)
        (answer,) = stream.take()
        assert isinstance(answer, Refusal)
        assert stream.task.done()

    async def fill(self, number: int) -> None:
        """The disk of a burst's session is full, or has room again."""
        await self.rest()
        session = self.bursts.sessions[number % 3]
        session.problem = None if session.problem else DiskFullError("the disk is full", hint="make room")

    def space(self, number: int) -> None:
        if (stream := self._stream(number)) is not None:
            space = SpoolSpace(camera=stream.name, free_bytes=number, spool="/")
            stream.say(space)
            if stream.is_opened:
                self.spaces.append(space)
                stream.expected.append(ReportAck())
            else:
                what = f"this stream may not send for camera {stream.name!r}"
                stream.expected.append(Refusal.of_error(BadInputError(what)))

    def forbidden(self, number: int) -> None:
        """A camera asks what operators may ask."""
        if (stream := self._stream(number)) is not None:
            stream.say(StatusRequest())
            stream.expected.append(Refusal)

    async def close(self, number: int) -> None:
        await self.rest()
        if number < 2 and (stream := self._stream(number)) is not None:
            stream.say(None)
        await self.rest()

    async def rest(self) -> None:
        """Wait until everything that was sent is answered."""
        await asyncio.sleep(1)
        for stream in self.streams:
            sent = stream.take()
            if stream.is_aborted:
                sent, stream.expected = sent[:0], []
            assert len(sent) == len(stream.expected), "each message has one answer"
            for answer, expected in zip(sent, stream.expected, strict=True):
                assert isinstance(answer, Refusal) if expected is Refusal else answer == expected
            stream.expected.clear()

    async def look(self, _: int = 0) -> None:
        """See that everything is as it should be, once all is answered."""
        await self.rest()
        for name in NAMES:
            own = [stream for stream in self.streams if stream.name == name]
            speaking = self.service._speaking.get(name)
            assert [
                stream for stream in own if stream.is_opened and stream.task and not stream.task.done()
            ] == ([] if speaking is None else [speaking])
        assert self.bursts.spools == self.spaces
        assert not +self.bursts.memory, "memory is not given back"
        assert self.bursts.given_up == self.given_up
        lines = self.service._options.log.after(0)
        assert {line.camera for line in lines} == {*self.given_up}
        assert all(stream.is_known is stream.is_named for stream in self.streams)
        assert len(self.bursts.progress) == sum(len(session.taken) for session in self.bursts.all_sessions)

    async def finish(self) -> None:
        await self.rest()
        for stream in self.streams:
            stream.say(None)
        await self.look()
        assert len(asyncio.all_tasks()) == 1, "something runs on"
        assert all(stream.task is not None and stream.task.done() for stream in self.streams)
        for session in self.bursts.all_sessions:
            assert not +session.streams, "a camera counts as connected for good"
            assert not -session.streams
        assert not self.service._speaking


USUAL = ("connect", "open", *("report", "images") * 4, "look")
OTHERS = ("report_of_other", "reopen", "fill", "space", "forbidden", "close", "nonsense", "stranger")


async def happen(history: list[tuple[str, int]]) -> None:
    duty = Duty()
    for step, number in history:
        result = getattr(duty, step)(number)
        if result is not None:
            await result
    await duty.finish()


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    loop = virtual_loop()
    yield loop
    loop.close()


@given(histories(USUAL, OTHERS, max_steps=30, max_others=3))
@example([("connect", 0), ("open", 0), ("report", 1), ("reopen", 1), ("report", 1)])
@settings(max_examples=150)
def test_each_message_is_answered_and_each_stream_ends_clean(
    loop: asyncio.AbstractEventLoop, history: list[tuple[str, int]]
) -> None:
    loop.run_until_complete(happen(history))
