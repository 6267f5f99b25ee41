"""Readers of what comes over a network."""

import asyncio
import random
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from capture_app.common.address import Address
from capture_app.common.errors import CameraError, SimulshotError
from capture_app.common.pairing_codes import Role
from capture_app.companions.phones import wire
from capture_app.companions.phones.phone import Phone
from capture_app.companions.softwaresync.app_leader import ANSWER, SAMPLES, AppLeader
from capture_app.net.channel import Channel
from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.wire.codec import WireError, decode, encode
from capture_app.trust.datagram_keys import LeaderKeys
from capture_app.trust.sealed_engines import SealedLeader
from capture_app.trust.sealing import SealError
from capture_app.trust.spake2_exchange import Invitations
from tests.fuzz.folders import Reader
from tests.unit.net.echoes import received_from


def read_datagram(data: bytes, folder: Path) -> None:
    """What is taken for a message is one: it can be sent on, and comes out the same."""
    with suppress(WireError):
        message = decode(data)
        assert decode(encode(message)) == message


def read_stream(expected: Any) -> Reader:
    """A transfer stream's reader of the messages that one side expects."""
    decoder = msgspec.json.Decoder(expected)

    def read(data: bytes, folder: Path) -> None:
        async def take() -> None:
            reader = asyncio.StreamReader()
            reader.feed_data(data)
            reader.feed_eof()
            channel: Channel[Any] = Channel(reader, _NoWriter(), decoder)  # type: ignore[arg-type]
            while await received_from(channel) is not None:
                pass

        with suppress(SimulshotError):
            asyncio.run(take())

    return read


class _NoWriter:
    """The writing end of a stream that is only read."""

    def get_extra_info(self, _: str) -> Any:
        return ("192.0.2.1", 1)


def read_sealed(data: bytes, folder: Path) -> None:
    """Whatever comes to a leader's port, which answers it by no more bytes; and to a client's."""
    here, there = Address("192.0.2.1", 1), Address("192.0.2.2", 2)
    leader = SealedLeader(Leader(LeaderConfig(1, 0, RequestedConfig(period_ns=10**7)), random.Random(1)))
    leader.receive_datagram(data, here, 1)
    assert sum(len(answer) for answer, _ in leader.datagrams_to_send(1)) <= len(data)
    with suppress(SealError):
        LeaderKeys().open(data, there)


def read_pairing_word(data: bytes, folder: Path) -> None:
    """What comes in place of a word or a proof of a pairing: it proves nothing."""
    desk = Invitations(lambda: 0.0)
    desk.invite(Role.CAMERA)
    with suppress(SimulshotError):
        _, invitation, key = desk.answer("a" * 32, data, "b" * 32)
        desk.accept(invitation, key, data)
        raise AssertionError("it was taken for a proof")


def read_phone_page(data: bytes, folder: Path) -> None:
    """What a phone's page says: messages, a length byte before each; those that begin with `{` are text."""
    now_ns, at = 10**12, 0
    hello = wire.PhoneHello(page="1", resolution_us=5.0)
    phone = Phone("fuzzed", lambda: now_ns, hello)

    def assert_honest(page_us: float) -> None:
        assert isinstance(phone.clock.gateway_ns(page_us), int)
        assert 0 <= phone.clock.uncertainty_ns(page_us) <= phone.clock.hard_bound_ns(page_us)

    phone.link_opened(_swallow, hello)
    phone.watch(lambda frame: assert_honest(frame.page_us), lambda _: None)
    phone.take_text(wire.Opened(width=640, height=480, frame_rate=30.0))
    while at < len(data):
        length, now_ns = data[at], now_ns + 3_000_000
        message, at = data[at + 1 : at + 1 + length], at + 1 + length
        with suppress(ValueError):
            if message.startswith(b"{"):
                said = wire.decode_text(message.decode(errors="replace"))
                if not isinstance(said, wire.PhoneHello):
                    phone.take_text(said)
                continue
            told = wire.decode_binary(message)
            if isinstance(told, wire.Ping):
                phone.clock.note_pong(told, now_ns, now_ns)
            phone.take_binary(told, now_ns)
    with suppress(CameraError):
        msgspec.json.encode(phone.facts)


async def _swallow(_: str | bytes) -> None:
    """The way to a page that is not there."""


def read_app_phone(data: bytes, folder: Path) -> None:
    """Whatever comes to the ports of phones with the paper's app: datagrams, a length byte before each.

    Of an odd length, it is the end of a clock answer, whose beginning is what was asked last.
    """
    now_ns, at, host = 10**12, 0, ("192.0.2.9", 1)
    leader = AppLeader(lambda line: None, lambda: now_ns)
    calls: list[bytes] = []
    leader.send = lambda sent, to: calls.append(sent)
    leader.datagram_received(b"\0\0\0\1a,192.0.2.9,false", host)
    # An honest phone of the same address, so that there is something to spoil.
    for _ in range(SAMPLES):
        now_ns += 20_000_000
        leader.rig_clock.add(ClockSample(now_ns - 9000, now_ns, now_ns, now_ns))
        leader.datagram_received(ANSWER.pack(now_ns - 9000, 5, 5 + len(calls)), host)
    while at < len(data):
        length, now_ns = data[at], now_ns + 3_000_000
        datagram, at = data[at + 1 : at + 1 + length], at + 1 + length
        if length % 2:
            datagram = ANSWER.pack(now_ns - 9000, 0, 0)[:8] + datagram[:16].ljust(16, b"\0")
        leader.datagram_received(datagram, host)
    for _ in range(7):
        leader.send_time()
        now_ns += 10**9
    assert leader.phones == {}
