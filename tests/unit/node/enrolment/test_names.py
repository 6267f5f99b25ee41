"""Whose camera a name is: that of the machine that had it first, whatever is restarted, wherever it joins."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.common.pairing_codes import Role
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.endpoint import PortOptions
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.relay_node import RelayNode
from capture_app.protocol.orders import RemoveCamera
from capture_app.session.reading.reader import Session
from capture_app.session.writing.recovery import RESERVE
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.wire.datagrams import JoinRefusal, Welcome
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader
from tests.images import small_jpeg
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced
from tests.unit.node.thieves import bring, granted, say_hello
from tests.waiting import time_limit, until

pytestmark = pytest.mark.virtual

CAM, THIEF = ("cam0", 1111), ("cam0", 2222)
FIVE = range(5)
TRUE_PICTURE = small_jpeg(b"the true picture")


@pytest.fixture
def trust(tmp_path: Path) -> Trust:
    return Trust(tmp_path / "leader")


@pytest.fixture
def owner(tmp_path: Path, trust: Trust) -> Trust:
    return introduced(tmp_path, trust, "owner")


@pytest.fixture
def thief(tmp_path: Path, trust: Trust) -> Trust:
    return introduced(tmp_path, trust, "thief")


@asynccontextmanager
async def leading(folder: Path, trust: Trust) -> AsyncIterator[LeaderNode]:
    async with await start_leader(folder / "sessions", trust=trust) as leader:
        yield leader


async def burst_of_five(leader: LeaderNode) -> BurstSession:
    return await leader.bursts.order(BurstOrder(frames=5))


def pictures(folder: Path) -> list[Path]:
    """Whole ones and begun ones; room kept for a manifest goes once the session is open again."""
    files = sorted((folder / "sessions").rglob("*.jpg")) + sorted((folder / "sessions").rglob("*.part"))
    return [file for file in files if file.name != RESERVE]


async def test_after_a_restart_of_the_leader_a_name_is_still_its_owners(
    tmp_path: Path, trust: Trust, owner: Trust, thief: Trust
) -> None:
    """Two machines of one hostname after a power cut, or one that waits for it."""
    async with leading(tmp_path, trust) as leader, joined(leader.own_address, CAM, trust=owner):
        session, run = await burst_of_five(leader), leader.instance
    burst = run, session.burst.number
    async with leading(tmp_path, trust) as leader:
        said = await say_hello(leader.own_address, thief, *THIEF)
        assert isinstance(said, JoinRefusal)
        assert "two machines are called cam0" in said.reason
        assert "capture-app cameras remove cam0" in said.reason
        assert granted(await bring(leader.own_address, thief, THIEF, burst, FIVE)) == []
        assert pictures(tmp_path) == []
        assert any("two machines are called cam0" in line.text for line in leader.log.after(0))
        async with joined(leader.own_address, CAM, trust=owner):
            answers = await bring(leader.own_address, owner, CAM, burst, FIVE, TRUE_PICTURE)
            assert len(granted(answers)) == 7, answers
            await until(lambda: (session.folder / "session.json").exists())
    assert all(file.read_bytes() == TRUE_PICTURE for file in pictures(tmp_path))


async def test_an_old_session_that_lacks_images_takes_them_from_its_camera_alone(
    tmp_path: Path, trust: Trust, owner: Trust, thief: Trust
) -> None:
    """Even where the name was freed since, and is another machine's now."""
    async with leading(tmp_path, trust) as leader:
        async with joined(leader.own_address, CAM, trust=owner):
            session, run = await burst_of_five(leader), leader.instance
        await session.finish_now("it sent nothing")
    burst = run, session.burst.number
    assert Session.open(session.folder).manifest.missing
    async with leading(tmp_path, trust) as leader:
        await leader.service.carry_out(RemoveCamera(name="cam0"))
        async with joined(leader.own_address, THIEF, trust=thief):
            answers = await bring(leader.own_address, thief, THIEF, burst, FIVE)
        assert len(granted(answers)) == 1, "the stream itself is its own"
        assert "another machine" in answers[1].what
        assert pictures(tmp_path) == []
        assert len(Session.open(session.folder).manifest.missing) == 5


@pytest.mark.parametrize("way", ["the leader itself", "the same relay", "another relay"])
async def test_the_name_of_a_camera_below_a_relay_is_its_owners_when_it_is_silent(
    tmp_path: Path, trust: Trust, owner: Trust, thief: Trust, way: str
) -> None:
    # A relay does not speak for machines that are paired with the leader.
    for machine in (owner,) if way == "the leader itself" else (owner, thief):
        trust.known.remove(machine.identity.pin)
    async with leading(tmp_path, trust) as leader:
        machines = [introduced(tmp_path, trust, f"relay-{n}", Role.RELAY) for n in range(2)]
        for at, machine in enumerate(machines):
            for one, role in ((owner, Role.CAMERA), (thief, Role.CAMERA)):
                own, other = one.identity, machine.identity
                machine.known.add(own.pin, role, name=f"{at}-{role}", certificate=own.certificate)
                one.known.add(other.pin, Role.LEADER, name=f"relay-{at}", certificate=other.certificate)
        async with await below(leader, machines[0]) as near, await below(leader, machines[1]) as far:
            async with joined(near.address, CAM, trust=owner):
                await until(lambda: "cam0" in {node.name for node in leader.status().nodes})
            await until(lambda: all(n.state == "lost" for n in leader.status().nodes if n.name == "cam0"))
            where = {"the same relay": near.address, "another relay": far.address}.get(
                way, leader.own_address
            )
            for instance in (2222, 3333):
                async with time_limit("a refusal, once a relay has asked"):
                    while not isinstance(await say_hello(where, thief, "cam0", instance), JoinRefusal):
                        pass
                (node,) = (node for node in leader.status().nodes if node.name == "cam0")
                assert (node.state, node.parent) == ("lost", near.name)
            async with joined(near.address, CAM, trust=owner):
                await until(lambda: all(n.state != "lost" for n in leader.status().nodes))
            # Once it is freed by hand, another machine can have it, also below the relay that knew it.
            await until(lambda: any(n.state == "lost" for n in leader.status().nodes))
            await leader.service.carry_out(RemoveCamera(name="cam0"))
            async with joined(where, ("cam0", 4444), trust=thief):
                await until(lambda: any(n.name == "cam0" for n in leader.status().nodes))


async def below(leader: LeaderNode, trust: Trust) -> RelayNode:
    name = trust.folder.name if trust.folder is not None else ""
    return await RelayNode.start(
        name, (leader.own_address,), PortOptions(host="127.0.0.1", port=0, trust=trust)
    )


async def test_a_name_is_free_when_it_is_removed_and_not_while_its_camera_is_here(
    tmp_path: Path, trust: Trust, owner: Trust, thief: Trust
) -> None:
    async with leading(tmp_path, trust) as leader:
        async with joined(leader.own_address, CAM, trust=owner):
            with pytest.raises(BadInputError, match="runs on"):
                await leader.service.carry_out(RemoveCamera(name="cam0"))
        await until(lambda: all(node.state == "lost" for node in leader.status().nodes))
        await leader.service.carry_out(RemoveCamera(name="cam0"))
        with pytest.raises(BadInputError, match="no node named cam0"):
            await leader.service.carry_out(RemoveCamera(name="cam0"))
        assert isinstance(await say_hello(leader.own_address, thief, *THIEF), Welcome)
    async with leading(tmp_path, trust) as leader:
        assert isinstance(await say_hello(leader.own_address, owner, *CAM), JoinRefusal), "kept on disk"
