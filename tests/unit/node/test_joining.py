"""A node whose leader does not answer finds it at another address by its key, or says why not, once."""

import asyncio
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import Mock, patch

import pytest

from capture_app.common.address import Address
from capture_app.node import joining
from capture_app.node.camera.device_profiles import NO_PROFILES, DeviceProfiles, node_key
from capture_app.node.joining import REFUSED_S, UNANSWERED, Joining
from capture_app.protocol.log import Log
from capture_app.protocol.pairing_messages import FoundLeader
from capture_app.sync.rig.failover import LeaderChoice
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.trust.trust import Trust
from tests.unit.net.ports import answering
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


class Browser:
    """What is announced."""

    found: Sequence[FoundLeader] = ()

    async def __aenter__(self) -> "Browser":
        return self

    async def __aexit__(self, *_: object) -> None: ...

    async def refresh(self) -> None: ...


@contextmanager
def announced(*leaders: FoundLeader) -> Iterator[None]:
    with (
        patch.object(joining, "LeaderBrowser", Browser),
        patch.object(Browser, "found", leaders),
        patch.object(joining, "FIND_EVERY_S", 0.01),
        patch.object(joining, "LOOK_EVERY_S", 0.01),
    ):
        yield


def joining_of(
    client: TimeClient,
    leaders: Sequence[Address],
    say: Callable[[str], None],
    profiles: DeviceProfiles = NO_PROFILES,
) -> Joining:
    key = node_key("cam")
    choice = LeaderChoice(tuple(leaders), client)
    return Joining(
        choice,
        Mock(),
        Mock(),
        Trust.open(),
        Log(say),
        leaders,
        followed=profiles.read(key).followed,
        remember=lambda followed: profiles.save(key, followed=followed),
    )


async def test_it_says_what_is_in_the_way_to_each_leader() -> None:
    said: list[str] = []
    leaders = closed_port(), Address("nobody.invalid", 47010)
    with announced():
        watching = asyncio.create_task(joining_of(asking_in_vain(), leaders, said.append).watch())
        await until(lambda: said)
        watching.cancel()
    (sentence,) = said
    assert "127.0.0.1 is reachable, but no leader listens" in sentence
    assert "cannot resolve host 'nobody.invalid'" in sentence


async def test_it_says_nothing_before_an_answer_is_missing() -> None:
    said: list[str] = []
    client = asking_in_vain(UNANSWERED - 1)
    with announced():
        watching = asyncio.create_task(joining_of(client, [closed_port()], said.append).watch())
        await asyncio.sleep(0.1)
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
    with announced():
        watching = asyncio.create_task(joining_of(client, others, said.append).watch())
        await until(lambda: said)
        watching.cancel()
    (sentence,) = said
    assert "no leader listens" not in sentence
    assert "cannot resolve host" in sentence


def followed_before(folder: Path, key: str, *addresses: Address) -> DeviceProfiles:
    profiles = DeviceProfiles(folder)
    assert profiles.save(node_key("cam"), followed={key: addresses})
    return profiles


@pytest.mark.parametrize("is_refused", [False, True])
async def test_a_lost_leader_is_joined_where_its_key_is_announced(tmp_path: Path, is_refused: bool) -> None:
    said: list[str] = []
    old = closed_port()
    client = asking_in_vain()
    if is_refused:
        # Another machine has its address, and does not know this one.
        client.note_refusal("it does not know this machine")
    async with answering() as new, answering() as other:
        leaders = (FoundLeader("a", (other,), key="8"), FoundLeader("b", (new,), key="7"))
        profiles = followed_before(tmp_path, "7", old)
        with announced(*leaders), patch.object(joining, "REFUSED_S", REFUSED_S / 100):
            found = joining_of(client, [old], said.append, profiles)
            watching = asyncio.create_task(found.watch())
            await until(lambda: len(profiles.read(node_key("cam")).followed["7"]) == 2)
            watching.cancel()
    assert said == [f"the leader at {old} is now at {new}"]
    assert profiles.read(node_key("cam")).followed == {"7": (old, new)}
    assert found._choice.leaders == (new,)
    assert found._choice.leader == new


async def test_a_lost_leader_is_joined_where_it_was_before_although_nothing_is_announced(
    tmp_path: Path,
) -> None:
    said: list[str] = []
    old = closed_port()
    async with answering() as before:
        with announced():
            found = joining_of(
                asking_in_vain(), [old], said.append, followed_before(tmp_path, "7", before, old)
            )
            watching = asyncio.create_task(found.watch())
            await until(lambda: said)
            watching.cancel()
    assert said == [f"the leader at {old} is now at {before}"]


async def test_of_a_leader_announced_elsewhere_no_firewall_at_its_old_address_is_blamed(
    tmp_path: Path,
) -> None:
    said: list[str] = []
    old, new = closed_port(), closed_port()
    with announced(FoundLeader("b", (new,), key="7")):
        found = joining_of(asking_in_vain(), [old], said.append, followed_before(tmp_path, "7", old))
        watching = asyncio.create_task(found.watch())
        await until(lambda: said)
        watching.cancel()
    assert said[0].startswith(f"the leader is announced at {new}: 127.0.0.1 is reachable, but no leader")
    assert f"port {old.port}" not in said[0]


async def test_a_leader_that_has_the_address_of_the_one_followed_is_left_for_it(tmp_path: Path) -> None:
    said: list[str] = []
    old = closed_port()
    client = asking_in_vain()
    client.number, client.followed = 1, Mock(leader=8)
    async with answering() as new:
        with announced(FoundLeader("b", (new,), key="7")):
            found = joining_of(client, [old], said.append, followed_before(tmp_path, "7", old))
            watching = asyncio.create_task(found.watch())
            await until(lambda: said)
            watching.cancel()
    assert (found._choice.leader, client.is_member) == (new, False)


async def test_the_leader_that_is_followed_is_stored_also_if_it_was_started_again(tmp_path: Path) -> None:
    leader, client = closed_port(), asking_in_vain()
    client.number, client.followed = 1, Mock(leader=8)
    profiles = followed_before(tmp_path, "7", leader)
    with announced():
        watching = asyncio.create_task(joining_of(client, [leader], print, profiles).watch())
        await until(lambda: profiles.read(node_key("cam")).followed == {"7": (leader,), "8": (leader,)})
        client.followed = Mock(leader=7)
        await until(lambda: [*profiles.read(node_key("cam")).followed] == ["8", "7"])
        watching.cancel()
