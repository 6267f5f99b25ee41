"""Machines that become known to a leader: by a code, by a pin, and not at all."""

from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from capture_app.common.camera_facts import EXACT_STAMPS
from capture_app.common.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import Channel, connect
from capture_app.node.enrolment import LOOK_EVERY_NS, Enrolment, ask_to_enrol, is_known, pair
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol import messages, orders, pairing_messages
from capture_app.protocol.log import Log
from capture_app.protocol.messages import FromLeader, NodeStream, Refusal
from capture_app.trust.sealed_engines import SealedLeader
from capture_app.trust.trust import Peer, Trust
from tests.cheap_rig import start_leader
from tests.unit.net.echoes import received_from
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced


@pytest.fixture
def machine(tmp_path: Path) -> Trust:
    return Trust(tmp_path / "machine")


@pytest.fixture
async def leader(tmp_path: Path) -> AsyncIterator[LeaderNode]:
    trust = Trust(tmp_path / "leader")
    async with await start_leader(tmp_path / "sessions", trust=trust) as node:
        yield node


@pytest.fixture
def home(tmp_path: Path) -> Trust:
    """The leader's own machine."""
    return Trust(tmp_path / "leader")


async def ask(leader: LeaderNode, trust: Trust, message: Any, **how: Any) -> Any:
    async with await connect(leader.own_address, FromLeader, trust=trust, **how) as channel:
        return await ask_on(channel, message)


async def ask_on(channel: Channel[Any], message: Any) -> Any:
    await channel.send(message)
    return await channel.receive_header()


async def invite(leader: LeaderNode, home: Trust, role: Role = Role.CAMERA) -> str:
    invited = await ask(leader, home, pairing_messages.Invite(role=role))
    assert isinstance(invited, pairing_messages.Invited)
    return invited.code


def news(leader: LeaderNode) -> list[str]:
    return [line.text for line in leader.log.after(0)]


async def test_a_code_makes_a_machine_known_for_ever(leader: LeaderNode, home: Trust, machine: Trust) -> None:
    assert not await is_known(leader.own_address, machine)
    code = await invite(leader, home)
    assert await pair(leader.own_address, code, machine) == (Role.CAMERA,)
    assert await is_known(leader.own_address, machine)
    assert await is_known(leader.own_address, Trust(machine.folder)), "also after it was started again"
    assert any("is now known as camera" in line for line in news(leader))
    with pytest.raises(UnknownMachineError, match="no pairing code"):
        await pair(leader.own_address, code, Trust(home.folder.parent / "another"))


async def test_a_wrong_code_changes_nothing_and_is_said(
    leader: LeaderNode, home: Trust, machine: Trust
) -> None:
    code = await invite(leader, home)
    with pytest.raises(UnknownMachineError, match="wrong pairing code"):
        await pair(leader.own_address, f"{(int(code) + 1) % 10**8:08d}", machine)
    assert home.known.all() == machine.known.all() == ()
    assert any("wrong code" in line for line in news(leader))
    await pair(leader.own_address, code, machine)


async def test_pins_that_are_pasted_on_both_sides_do_without_a_code(
    leader: LeaderNode, home: Trust, machine: Trust
) -> None:
    machine.known.add(home.identity.pin, Role.LEADER)
    with pytest.raises(UnknownMachineError, match=f"trust add {machine.identity.pin}"):
        await connect(leader.own_address, FromLeader, trust=machine)
    with pytest.raises(UnknownMachineError, match="does not know this machine"):
        await ask_to_enrol(leader.own_address, machine)
    assert not await is_known(leader.own_address, machine)
    assert home.known.all() == ()
    assert any("wants to join" in line for line in news(leader))
    home.known.add(machine.identity.pin, Role.CAMERA, name="garage")
    shown: list[str] = []
    leader.log.show = shown.append
    for _ in range(5):
        await ask_to_enrol(leader.own_address, machine)
    assert shown == ["garage is now known"], "said once, however often it knocks"
    assert await is_known(leader.own_address, machine)


async def test_a_machine_shows_itself_to_no_leader_that_it_does_not_know(
    leader: LeaderNode, home: Trust, machine: Trust
) -> None:
    home.known.add(machine.identity.pin, Role.CAMERA)
    with pytest.raises(UnknownMachineError, match="does not know the leader"):
        await ask_to_enrol(leader.own_address, machine)
    (known,) = home.known.all()
    assert known.certificate is None


OF_STRANGERS = [
    pairing_messages.EnrolRequest(certificate=b"nothing"),
    pairing_messages.PairingProof(proof=b""),
]
OTHERS = [
    messages.StatusRequest(),
    messages.BurstRequest(frames=1),
    messages.SpoolSpace(camera="cam0", free_bytes=0, spool="/"),
    NodeStream(camera="cam0", instance=1),
    orders.WatchRequest(),
    orders.DetailRequest(camera="cam0"),
    orders.SaveStamp(camera="cam0", stamp=EXACT_STAMPS),
    NodeStream(camera="cam0", instance=1, shows=True),
    orders.AddCamera(spec="sim"),
    orders.AddSimulated(cameras=1),
    orders.RemoveCamera(name="cam0"),
    orders.CancelBurst(burst=1),
    orders.StopRig(),
    pairing_messages.Invite(role=Role.OPERATOR),
    pairing_messages.SpeaksFor(pin="x", name="x", roles=(Role.OPERATOR,)),
]


@pytest.mark.parametrize("message", OTHERS + OF_STRANGERS, ids=lambda message: type(message).__name__)
async def test_a_stranger_is_answered_with_a_sentence_and_nothing_else(
    leader: LeaderNode, home: Trust, machine: Trust, message: Any
) -> None:
    async with await connect(leader.own_address, FromLeader, trust=machine, as_unknown=True) as channel:
        refusal = await ask_on(channel, message)
        assert isinstance(refusal, Refusal)
        assert isinstance(refusal.as_error(), SimulshotError)
        assert await channel.receive_header() is None
    assert home.known.all() == ()
    assert leader.status().nodes == ()


@pytest.mark.parametrize("message", OTHERS, ids=lambda message: type(message).__name__)
async def test_cameras_and_operators_may_each_do_their_part(
    leader: LeaderNode, home: Trust, machine: Trust, message: Any
) -> None:
    of_camera = isinstance(message, messages.SpoolSpace | NodeStream)
    of_relay = isinstance(message, pairing_messages.SpeaksFor)
    others = Role.OPERATOR if of_camera or of_relay else Role.CAMERA
    await pair(leader.own_address, await invite(leader, home, others), machine)
    refusal = await ask(leader, machine, message)
    assert isinstance(refusal, Refusal)
    assert f"known here as {others}" in refusal.what


async def test_who_is_removed_loses_its_open_streams(leader: LeaderNode, home: Trust, machine: Trust) -> None:
    await pair(leader.own_address, await invite(leader, home, Role.OPERATOR), machine)
    async with await connect(leader.own_address, FromLeader, trust=machine) as channel:
        await channel.send(orders.WatchRequest())
        assert isinstance(await channel.receive_header(), messages.StatusAnswer)
        home.known.remove(machine.identity.pin)
        with suppress(NetworkError):
            while await received_from(channel) is not None:
                pass
    assert not await is_known(leader.own_address, machine)


async def test_strangers_cannot_fill_the_news(leader: LeaderNode, home: Trust, machine: Trust) -> None:
    machine.known.add(home.identity.pin, Role.LEADER)
    shown = list[str]()
    leader.log.show = shown.append
    for _ in range(5):
        with pytest.raises(UnknownMachineError):
            await ask_to_enrol(leader.own_address, machine)
    assert len([line for line in shown if "wants to join" in line]) == 1


PICTURES_OF = {"cam0": 1111, "cam1": 2222}


async def test_a_camera_brings_its_own_pictures_and_no_other_machines(
    leader: LeaderNode, home: Trust, machine: Trust, tmp_path: Path
) -> None:
    """Both are cameras of the rig, and each knows by which run the other has joined."""
    other = Trust(tmp_path / "other")
    for trust in (machine, other):
        await pair(leader.own_address, await invite(leader, home), trust)
    nodes = [
        joined(leader.own_address, (name, PICTURES_OF[name]), trust=trust)
        for name, trust in (("cam0", machine), ("cam1", other))
    ]
    async with nodes[0], nodes[1]:
        for name, trust, may in (
            ("cam0", machine, True),
            ("cam1", machine, False),
            ("cam0", other, False),
            ("cam1", other, True),
            ("cam0", home, False),
        ):
            for shows in (False, True):
                if shows and may:
                    continue  # it is asked things, not answered
                opening = NodeStream(camera=name, instance=PICTURES_OF[name], shows=shows)
                answer = await ask(leader, trust, opening)
                assert isinstance(answer, Refusal) is not may, (name, trust, shows)


def enrolment_of(trust: Trust, kept: list[set[str]]) -> Enrolment:
    """An enrolment that notes whose keys it keeps each time that it revokes some."""
    sealed = SimpleNamespace(
        keys=SimpleNamespace(revoke_all_but=kept.append),
        refusals=SimpleNamespace(take_events=lambda _: ()),
        set_direct_pins=lambda *_: None,
    )
    return Enrolment(trust, Log(), cast(SealedLeader, sealed))


def test_nodes_ask_for_keys_anew_when_a_standby_becomes_known(tmp_path: Path, home: Trust) -> None:
    """The answer says who may lead in the leader's place: who keeps its key would not follow that one."""
    camera, kept = introduced(tmp_path, home, "camera").identity.pin, list[set[str]]()
    enrolment, own = enrolment_of(home, kept), home.identity.pin
    enrolment.look(0)
    assert kept == [{own, camera}]
    enrolment.look(LOOK_EVERY_NS)
    assert len(kept) == 1, "nothing has changed"
    second = introduced(tmp_path, home, "second", Role.STANDBY).identity.pin
    enrolment.look(2 * LOOK_EVERY_NS)
    assert kept[1:] == [{own}]
    other = introduced(tmp_path, home, "other").identity.pin
    enrolment.look(3 * LOOK_EVERY_NS)
    assert kept[2:] == [{own, camera, second, other}]


async def test_a_relay_speaks_for_cameras_and_operators_alone(home: Trust) -> None:
    relay = Peer("relay's pin", "relay", frozenset({Role.RELAY}))
    channel: Any = SimpleNamespace(who=relay)
    said = pairing_messages.SpeaksFor(pin="its pin", name="node", roles=tuple(Role), node=("cam0", 1))
    await enrolment_of(home, []).answer(channel, said)
    assert channel.who == Peer(
        "its pin", "node", frozenset({Role.CAMERA, Role.OPERATOR}), via="relay's pin", node=("cam0", 1)
    )
