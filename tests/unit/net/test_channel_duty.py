"""What a stream's two ends owe each other, message by message, without a socket and in virtual time."""

import asyncio
import errno
import random
import socket
import ssl
import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, UnknownMachineError
from capture_app.common.pairing_codes import Role
from capture_app.common.timeouts import CLOSE_TIMEOUT_S
from capture_app.net import channel as module
from capture_app.net.channel import FOR_EVER, Channel, StreamTimeouts, TooLargeMessageError, connect
from capture_app.trust.trust import ANYBODY, Peer
from tests.unit.net.echoes import PING, Ping

pytestmark = pytest.mark.virtual
PREFIX = struct.Struct(">4sIQ")
TIMEOUTS = StreamTimeouts(first_s=10.0, idle_s=100.0, message_s=30.0, header_bytes=len(PING) + 5)


class Wire:
    """The sending end of a stream whose peer takes in `rate` bytes a second."""

    def __init__(self, rate: float = 1e9) -> None:
        self.sent, self.buffered, self.rate = bytearray(), 0.0, rate
        self.is_aborted = self.is_closed = False
        self.transport = self
        self.options: list[tuple[int, ...]] = []

    def get_extra_info(self, name: str) -> Any:
        return {"peername": ("192.0.2.7", 5), "socket": self}.get(name)

    def setsockopt(self, *option: int) -> None:
        self.options.append(option)

    def get_write_buffer_size(self) -> int:
        return int(self.buffered)

    def is_closing(self) -> bool:
        return self.is_aborted or self.is_closed

    def write(self, data: bytes | memoryview) -> None:
        assert not self.is_closing()
        self.sent += data
        self.buffered += len(data)

    async def drain(self) -> None:
        while self.buffered > 100:
            if self.is_aborted:
                raise ConnectionResetError("Connection lost")
            await asyncio.sleep(1.0)
            self.buffered = max(0.0, self.buffered - self.rate)

    def close(self) -> None:
        assert not self.is_closed
        self.is_closed = True

    async def wait_closed(self) -> None:
        while self.buffered and not self.is_aborted:
            await asyncio.sleep(1.0)
            self.buffered = max(0.0, self.buffered - self.rate)

    def abort(self) -> None:
        self.is_aborted = True


def stream(timeouts: StreamTimeouts = FOR_EVER, rate: float = 1e9) -> tuple[Channel[Ping], Any, Wire]:
    """A channel, what arrives there, and what it sends."""
    arriving, wire = asyncio.StreamReader(), Wire(rate)
    writer: Any = wire
    return Channel(arriving, writer, msgspec.json.Decoder(Ping), timeouts), arriving, wire


def with_header(data: bytes) -> bytes:
    """A message of that header, without a payload."""
    return PREFIX.pack(b"SSH1", len(data), 0) + data


async def receive_all(channel: Channel[Ping]) -> None:
    while await channel.receive_header():
        pass


async def after_s(waiting: Callable[[], Any]) -> tuple[float, str]:
    """How long something takes, in virtual s, and the error with which it ends."""
    loop = asyncio.get_running_loop()
    began_s, said = loop.time(), ""
    try:
        await waiting()
    except NetworkError as error:
        said = error.what
    return loop.time() - began_s, said


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32))
async def test_what_is_sent_arrives_however_it_is_cut_up_and_a_cut_is_said(seed: int) -> None:
    chance = random.Random(seed)
    sender, _, wire = stream()
    messages = [
        (Ping(chance.randrange(1000)), chance.randbytes(chance.choice([0, 1, 500]))) for _ in range(5)
    ]
    ends = [0]
    for message, payload in messages:
        place = chance.randrange(len(payload) + 1)
        await sender.send(message, payload[:place], memoryview(payload)[place:])
        ends.append(len(wire.sent))
    cut = chance.choice([*ends, chance.randrange(ends[-1])])

    async def feed() -> None:
        at = 0
        while at < cut:
            size = chance.randrange(1, 300)
            arriving.feed_data(bytes(wire.sent[at : min(cut, at + size)]))
            at += size
            await asyncio.sleep(0.1)
        arriving.feed_eof()

    receiver, arriving, _ = stream(TIMEOUTS)
    whole = [of for of, end in zip(messages, ends[1:], strict=True) if end <= cut]
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(feed())
        for message, payload in whole:
            assert await receiver.receive_header() == message
            assert receiver.has_spoken
            assert receiver.unread == len(payload)
            if chance.random() < 0.5:
                assert b"".join([chunk async for chunk in receiver.payload()]) == payload
                assert receiver.unread == 0
        if cut in ends:
            assert await receiver.receive_header() is None
        else:
            assert "broke off in the middle" in (await after_s(lambda: receive_all(receiver)))[1]
    assert receiver.has_spoken is bool(whole) or cut not in ends


@pytest.mark.parametrize("is_known", [False, True])
@pytest.mark.parametrize(("header", "payload"), [(0, 0), (1, 0), (0, 1)])
async def test_a_message_of_the_limit_is_taken_and_a_longer_one_is_not(
    monkeypatch: pytest.MonkeyPatch, is_known: bool, header: int, payload: int
) -> None:
    limit = len(PING) + (9 if is_known else 5)
    monkeypatch.setattr(module, "MAX_PAYLOAD_BYTES", 20)
    monkeypatch.setattr(module, "MAX_HEADER_BYTES", len(PING) + 9)
    receiver, arriving, _ = stream(TIMEOUTS)
    receiver.is_known = is_known
    data = PING.ljust(limit + header)
    arriving.feed_data(PREFIX.pack(b"SSH1", len(data), 20 + payload) + data + bytes(20 + payload))
    if header or payload:
        with pytest.raises(NetworkError, match=f"over the limit of {limit} \\+ 20"):
            await receiver.receive_header()
        assert not receiver.has_spoken
    else:
        assert await receiver.receive_header() == Ping(1)


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "transfer protocol"),
        (b"SSH", "broke off in the middle"),
        (with_header(b"{}"), "unreadable message"),
        (with_header(b'{"type":"ping","number":1,"more":' + b"[" * 50_000), "unreadable message"),
        (with_header(b'{"type":"ping\xff","number":1}'), "unreadable message"),
        (with_header(b'{"type":"ping","number":' + b"9" * 5000 + b"}"), "unreadable message"),
        (with_header(b"\xff\xfe\x00"), "unreadable message"),
    ],
)
async def test_what_is_no_message_is_said(sent: bytes, why: str) -> None:
    receiver, arriving, _ = stream()
    arriving.feed_data(sent)
    arriving.feed_eof()
    with pytest.raises(NetworkError, match=why):
        await receiver.receive_header()
    assert not receiver.has_spoken


async def test_a_connection_that_is_lost_is_said() -> None:
    receiver, arriving, _ = stream()
    arriving.set_exception(ConnectionResetError("Connection reset by peer"))
    with pytest.raises(NetworkError, match="the connection broke off: Connection reset by peer"):
        await receiver.receive_header()


async def test_what_no_peer_would_accept_is_not_sent_and_the_stream_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "MAX_PAYLOAD_BYTES", 20)
    monkeypatch.setattr(module, "MAX_HEADER_BYTES", len(PING))
    sender, _, wire = stream()
    for message, payloads in ((Ping(1), (bytes(20), b"1")), (Ping(10), ())):
        with pytest.raises(TooLargeMessageError):
            await sender.send(message, *payloads)
    assert not wire.sent
    await sender.send(Ping(1), bytes(19), b"1")
    assert wire.sent == PREFIX.pack(b"SSH1", len(PING), 20) + PING + bytes(19) + b"1"


@pytest.mark.parametrize(
    ("heard", "limit_s", "why"),
    [
        (b"", 10.0, "silent"),
        (b"SSH", 10.0, "silent"),
        (PREFIX.pack(b"SSH1", len(PING), 0), 30.0, "did not arrive in time"),
        (with_header(PING), 100.0, "silent"),
        (PREFIX.pack(b"SSH1", len(PING), 9) + PING + b"...", 30.0, "did not arrive in time"),
    ],
)
async def test_a_peer_has_so_long_for_each_part_of_a_message(heard: bytes, limit_s: float, why: str) -> None:
    receiver, arriving, _ = stream(TIMEOUTS)
    arriving.feed_data(heard)

    waited_s, said = await after_s(lambda: receive_all(receiver))
    assert (waited_s, why in said) == (limit_s, True)


async def test_a_peer_that_mainly_receives_may_be_silent_between_messages_and_not_within() -> None:
    receiver, arriving, _ = stream(TIMEOUTS)
    receiver.allow_silence()
    arriving.feed_data(with_header(PING))
    assert await receiver.receive_header() == Ping(1)
    asyncio.get_running_loop().call_later(1000.0, arriving.feed_data, PREFIX.pack(b"SSH1", len(PING), 0))
    waited_s, said = await after_s(receiver.receive_header)
    assert "did not arrive in time" in said
    assert waited_s == pytest.approx(1000.0 + 30.0, abs=0.5)


@pytest.mark.parametrize(("rate", "stall_s", "limit_s"), [(0, None, 30.0), (0, 5.0, 5.0), (100, 1.5, None)])
async def test_a_peer_that_takes_nothing_in_is_given_up_and_a_slow_one_is_not(
    rate: float, stall_s: float | None, limit_s: float | None
) -> None:
    sender, _, wire = stream(TIMEOUTS, rate)
    waited_s, said = await after_s(lambda: sender.send(Ping(1), bytes(1000), stall_s=stall_s))
    assert wire.is_aborted is (limit_s is not None)
    if limit_s is None:
        assert (said, waited_s >= 9) == ("", True)
    else:
        assert (waited_s, said) == (limit_s, "the peer does not receive anything")
    wire.abort()
    assert "broke off: Connection lost" in (await after_s(lambda: sender.send(Ping(2))))[1]


@pytest.mark.parametrize(
    ("timeouts", "rate", "limit_s"),
    [(TIMEOUTS, 0, 30.0), (FOR_EVER, 0, CLOSE_TIMEOUT_S), (TIMEOUTS, 10, 10.0)],
)
async def test_a_stream_closes_once_its_peer_has_everything_or_in_time(
    timeouts: StreamTimeouts, rate: float, limit_s: float
) -> None:
    channel, _, wire = stream(timeouts, rate)
    wire.write(bytes(100))
    async with channel:
        pass
    assert (await after_s(channel.close))[0] == 0 if rate else True
    assert wire.is_closed
    assert wire.is_aborted is not bool(rate)
    assert asyncio.get_running_loop().time() >= limit_s


@pytest.mark.parametrize(("timeouts", "waits"), [(FOR_EVER, False), (TIMEOUTS, True)])
async def test_a_program_that_is_stopped_does_not_wait_for_its_leader(
    timeouts: StreamTimeouts, waits: bool
) -> None:
    channel, _, wire = stream(timeouts, rate=10)
    wire.write(bytes(100))

    async def use() -> None:
        async with channel:
            await asyncio.Event().wait()

    using = asyncio.create_task(use())
    await asyncio.sleep(1.0)
    using.cancel()
    waited_s, _ = await after_s(lambda: asyncio.wait({using}))
    assert (waited_s > 5, wire.is_aborted) == (waits, not waits)


async def test_a_relay_passes_all_on_as_fast_as_it_is_taken_in() -> None:
    below, from_below, _ = stream()
    above, _, wire = stream(rate=100)
    from_below.feed_data(bytes(500))
    relaying = asyncio.create_task(below.relay(above))
    await asyncio.sleep(0.5)
    from_below.feed_data(bytes(500))
    from_below.feed_eof()
    await asyncio.sleep(0.5)
    assert (len(wire.sent), below.has_spoken, above.has_spoken) == (500, True, False)
    await relaying
    assert len(wire.sent) == 1000


def test_streams_of_a_machine_are_those_of_its_key_or_of_its_host() -> None:
    async def machines() -> list[str]:
        channel, _, _ = stream()
        assert channel.peer == Address("192.0.2.7", 5)
        seen = [channel.machine]
        for who in (Peer("pin"), Peer("pin", via="relay")):
            channel.who = who
            seen.append(channel.machine)
        return seen

    assert asyncio.run(machines()) == ["192.0.2.7", "pin", "relay"]


LEADER = Address("192.0.2.1", 47010)


class Paired:
    """A machine's trust, which knows that leader or does not; `key` is what the leader shows."""

    def __init__(self, *, key: str = "leader", is_open: bool = False) -> None:
        self.key, self.is_open = key, is_open
        self.identity = SimpleNamespace(pin="own-pin")
        leaders = (SimpleNamespace(roles=(Role.LEADER,)),) if key else ()
        self.known = SimpleNamespace(all=lambda: leaders)

    def client_context(self, *, as_unknown: bool) -> object:
        return None if self.is_open else ("context", as_unknown)

    def peer(self, _: bytes | None) -> Peer:
        return ANYBODY if self.is_open else Peer("pin", roles=frozenset({Role(self.key)} if self.key else ()))


def answering(monkeypatch: pytest.MonkeyPatch, *answers: bytes | BaseException | None) -> list[Wire]:
    """Let connections end so, one after the other: greeted with these bytes, refused, or never; None: cut."""
    wires, left = list[Wire](), [*answers]

    async def open_connection(*_: Any, **__: Any) -> tuple[asyncio.StreamReader, Wire]:
        if isinstance(answer := left.pop(0), BaseException):
            if isinstance(answer, TimeoutError):
                await asyncio.Event().wait()
            raise answer
        arriving = asyncio.StreamReader()
        arriving.feed_data(answer or b"")
        arriving.feed_eof()
        wires.append(Wire())
        return arriving, wires[-1]

    monkeypatch.setattr(asyncio, "open_connection", open_connection)
    return wires


REFUSED = ConnectionRefusedError(errno.ECONNREFUSED, "Connect call failed ('192.0.2.1', 47010)")
RESET = ConnectionResetError(errno.ECONNRESET, "Connection reset by peer")


@pytest.mark.parametrize(
    ("trust", "answers", "kind", "why"),
    [
        (Paired(), (REFUSED,), NetworkError, "no leader at 192.0.2.1:47010: Connection refused"),
        (Paired(), (UnicodeError("label too long"),), NetworkError, "47010: label too long"),
        (Paired(), (socket.gaierror(-2, "Name unknown"),), NetworkError, "resolve host '192.0.2.1': Name"),
        (Paired(), (TimeoutError(), REFUSED), NetworkError, "no answer from a leader at .* within 5 s"),
        (Paired(), (TimeoutError(), TimeoutError()), NetworkError, "no answer from a leader at"),
        (Paired(), (TimeoutError(), b""), NetworkError, "is open, but nothing there answers"),
        (Paired(is_open=True), (RESET,), NetworkError, "no leader at .*: Connection reset"),
        (Paired(), (RESET,), UnknownMachineError, "not prove its identity: it is no longer paired"),
        (Paired(key=""), (RESET,), UnknownMachineError, "not prove its identity \\("),
        (Paired(), (ssl.SSLError("cut"),), UnknownMachineError, "not prove its identity"),
        (Paired(key="camera"), (b"SSH1",), UnknownMachineError, "does not know the leader at"),
        (Paired(), (None,), UnknownMachineError, "the leader at .* does not know this machine"),
        (Paired(), (b"HTTP",), NetworkError, "is not a leader's port"),
    ],
)
async def test_why_a_leader_is_not_reached_is_said_and_its_stream_is_closed(
    monkeypatch: pytest.MonkeyPatch,
    trust: Any,
    answers: tuple[bytes | BaseException | None, ...],
    kind: type[NetworkError],
    why: str,
) -> None:
    wires = answering(monkeypatch, *answers)
    with pytest.raises(NetworkError, match=why) as refused:
        await connect(LEADER, Ping, trust=trust)
    assert type(refused.value) is kind
    assert all(wire.is_closing() for wire in wires)


@pytest.mark.parametrize(
    ("trust", "as_unknown", "greeting"),
    [(Paired(), False, b"SSH1"), (Paired(key=""), True, b"SSH1"), (Paired(is_open=True), False, b"")],
)
async def test_a_leader_that_is_known_or_need_not_be_is_spoken_to(
    monkeypatch: pytest.MonkeyPatch, trust: Any, as_unknown: bool, greeting: bytes
) -> None:
    wires = answering(monkeypatch, greeting + with_header(PING))
    channel = await connect(LEADER, Ping, trust=trust, as_unknown=as_unknown)
    assert not wires[0].is_closing()
    assert channel.who == trust.peer(None)
    assert await channel.receive_header() == Ping(1)
