"""A node whose leader does not answer says by itself why, once, and again when it is another reason."""

import asyncio
import socket

from capture_app.common.address import Address
from capture_app.node.joining import UNANSWERED, watch_join
from capture_app.protocol.log import Log
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from tests.waiting import until


def asking_in_vain(hellos: int = UNANSWERED) -> TimeClient:
    client = TimeClient("cam", 7, Timekeeper(1))
    for _ in range(hellos):
        client.handle_timer(client.next_timer())
        client.datagrams_to_send(0)
    return client


def closed_port() -> Address:
    with socket.create_server(("127.0.0.1", 0)) as stream:
        return Address("127.0.0.1", stream.getsockname()[1])


async def test_it_says_what_is_in_the_way_to_each_leader() -> None:
    said: list[str] = []
    leaders = closed_port(), Address("nobody.invalid", 47010)
    watching = asyncio.create_task(watch_join(asking_in_vain(), leaders, Log(said.append)))
    await until(lambda: said)
    watching.cancel()
    (sentence,) = said
    assert "127.0.0.1 is reachable, but no leader listens" in sentence
    assert "cannot resolve host 'nobody.invalid'" in sentence


async def test_it_says_nothing_before_an_answer_is_missing() -> None:
    said: list[str] = []
    client = asking_in_vain(UNANSWERED - 1)
    watching = asyncio.create_task(watch_join(client, [closed_port()], Log(said.append)))
    await asyncio.sleep(0.6)
    assert said == []
    client.handle_timer(client.next_timer())
    await until(lambda: said)
    watching.cancel()


async def test_what_the_leader_said_itself_is_not_said_again() -> None:
    said: list[str] = []
    leader, client = closed_port(), asking_in_vain()
    client.note_refusal(
        f"127.0.0.1 is reachable, but no leader listens on its port {leader.port} (as it said)"
    )
    for _ in range(UNANSWERED):
        client.handle_timer(client.next_timer())
    others = leader, Address("nobody.invalid", 47010)
    watching = asyncio.create_task(watch_join(client, others, Log(said.append)))
    await until(lambda: said)
    watching.cancel()
    (sentence,) = said
    assert "no leader listens" not in sentence
    assert "cannot resolve host" in sentence
