"""Beacons over real multicast, on the loopback interface."""

import asyncio
import random
import socket
import time
from contextlib import closing

import pytest

from capture_app.common.clock import HostClock
from capture_app.common.interfaces import source_address
from capture_app.net.multicast import BeaconReceiver, BeaconSender, open_group_socket
from capture_app.sync.wire.messages import Group

ELSEWHERE = "127.0.0.2"
"""As if another machine: the way there begins at another address than its own."""


def free_group() -> Group:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return Group(f"239.255.47.{random.randint(11, 250)}", probe.getsockname()[1])


@pytest.fixture
def group() -> Group:
    group = free_group()
    sock = open_group_socket(group, "127.0.0.1")
    if sock is None:
        pytest.skip("no multicast on the loopback interface here")
    sock.close()
    return group


class Notes:
    """What an ear has heard."""

    def __init__(self) -> None:
        self.heard: asyncio.Queue[tuple[bytes, int]] = asyncio.Queue()
        self.ear = BeaconReceiver(lambda *beacon: self.heard.put_nowait(beacon), HostClock(), lambda: None)

    async def next(self) -> tuple[bytes, int]:
        async with asyncio.timeout(5.0):
            return await self.heard.get()


async def test_all_who_listen_hear_a_beacon_and_when(group: Group) -> None:
    both, sender = (Notes(), Notes()), BeaconSender(group)
    with closing(sender), closing(both[0].ear), closing(both[1].ear):
        for notes in both:
            notes.ear.follow(group, "127.0.0.1")
        sender.send(b"nobody is reached yet")
        sender.set_destinations(["127.0.0.1"])
        sender.send(b"not to this machine itself")
        sender.set_destinations([ELSEWHERE, ELSEWHERE, "::1"])
        before_ns = time.monotonic_ns()
        sender.send(b"one")
        after_ns = time.monotonic_ns()
        for notes in both:
            data, at_ns = await notes.next()
            assert data == b"one"
            assert before_ns <= at_ns <= after_ns + 1_000_000_000


async def test_an_ear_follows_one_leader_at_a_time(group: Group) -> None:
    other, notes = free_group(), Notes()
    senders = BeaconSender(group), BeaconSender(other)
    with closing(senders[0]), closing(senders[1]), closing(notes.ear):
        notes.ear.follow(group, "127.0.0.1")
        notes.ear.follow(other, "127.0.0.1")
        for sender, data in zip(senders, (b"old", b"new"), strict=True):
            sender.set_destinations([ELSEWHERE])
            sender.send(data)
        assert (await notes.next())[0] == b"new"
        assert notes.heard.empty()
        notes.ear.follow(None, "127.0.0.1")
        senders[1].send(b"unheard")
        await asyncio.sleep(0.05)
        assert notes.heard.empty()


def test_what_cannot_be_heard_is_silence() -> None:
    group = Group("239.255.47.10", 47011)
    assert open_group_socket(group, "::1") is None
    assert source_address("127.0.0.1") == "127.0.0.1"
    sender = BeaconSender(group)
    sender.set_destinations(["::1"])
    sender.send(b"to nobody")
    sender.close()
    sender.close()
