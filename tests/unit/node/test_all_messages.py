"""Every message of a stream, by whoever should not send it: a stranger, a camera, an operator; and again."""

import asyncio
import typing
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec import inspect

from benchmarks.endurance.field_attacks import attacks, example
from capture_app.common.camera_facts import EXACT_STAMPS, CameraControls, Control
from capture_app.common.errors import NetworkError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import connect
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol import messages as wire
from capture_app.protocol import orders, pairing_messages
from capture_app.protocol.messages import FromLeader, ToLeader
from capture_app.protocol.permissions import SENDERS
from capture_app.protocol.status import NodeDetail, Preview
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord, ImageRecord, image_path
from capture_app.session.format.marks import Mark
from capture_app.sync.clock.clock_filter import PathAsymmetry
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader
from tests.facts import make_facts
from tests.waiting import until

from .joining import joined
from .sealed_nodes import SealedNode, introduced, sealed_node

pytestmark = pytest.mark.virtual

SHA = "0" * 64
"""Of nothing."""
STARTS_OR_ENDS = {
    orders.AddCamera,
    orders.AddSimulated,
    orders.InvitePhone,
    orders.StopRig,
    orders.WatchRequest,
    orders.PreviewRequest,
    orders.PreviewSeen,
}
"""Messages that start programs or streams without an end, belong to such a stream, or end the rig."""


def every_message(node: SealedNode) -> list[Any]:
    """One of each kind, as somebody makes it up who knows the camera's name and the run of its node."""
    record = CameraRecord(name="cam", facts=make_facts())
    image = ImageRecord(camera="cam", instant=0, path=image_path("cam", 0), sha256=SHA, bytes=1, leader_ns=0)
    messages = [
        wire.NodeStream(camera="cam", instance=node.instance),
        wire.CameraReport(leader=1, burst=1, plan=CameraPlan(camera=record, instants=(0,))),
        wire.ImageBatch(images=(wire.ImageUpload(leader=1, burst=1, record=image),)),
        wire.SpoolSpace(camera="cam", free_bytes=0, spool="/"),
        wire.KeyRequest(name="cam", instance=node.instance, is_relay=True),
        wire.StatusRequest(),
        wire.BurstRequest(frames=1),
        orders.WatchRequest(),
        orders.PreviewRequest(width=100, fps=1.0),
        orders.PreviewSeen(camera="cam"),
        orders.DetailRequest(camera="cam"),
        orders.AddCamera(spec="sim:pi"),
        orders.AddSimulated(cameras=1),
        orders.RemoveCamera(name="cam"),
        orders.CancelBurst(burst=1),
        orders.EndBurst(burst=1),
        orders.StaggerCameras(order="even"),
        orders.StopRig(),
        orders.InvitePhone(),
        orders.ControlsRequest(camera="cam", values={Control.GAIN: 2.0}),
        orders.ControlsAnswer(camera="cam", state=CameraControls()),
        wire.NodeStream(camera="cam", instance=node.instance, shows=True),
        orders.CameraHealth(fps=1.0),
        orders.SaveStamp(camera="cam", stamp=EXACT_STAMPS, asymmetry=PathAsymmetry(1, 2, 3)),
        orders.StampSaved(camera="cam", is_stored=True),
        orders.AskTime(),
        orders.PlaceMark(mark=Mark(text="stimulus", leader_ns=0, uncertainty_ns=0)),
        Preview(camera="cam", leader_ns=0, width=1, height=1),
        NodeDetail(camera="cam"),
        pairing_messages.EnrolRequest(certificate=b"none"),
        pairing_messages.PairingMessage(certificate=b"none", name="x", spake2_message=b""),
        pairing_messages.PairingProof(proof=b""),
        pairing_messages.Invite(role=Role.OPERATOR),
        pairing_messages.SpeaksFor(pin="x", name="x", roles=(Role.OPERATOR,)),
    ]
    assert {type(message) for message in messages} == set(typing.get_args(ToLeader))
    return messages


@pytest.fixture
async def leader(tmp_path: Path, trust: Trust) -> AsyncIterator[LeaderNode]:
    async with await start_leader(tmp_path / "sessions", trust=trust, spool=tmp_path / "spool") as node:
        yield node


async def answer(leader: LeaderNode, trust: Trust, message: Any, *, as_unknown: bool = False) -> Any:
    """What a leader answers to one message on a stream of its own; None where it breaks the stream off."""
    try:
        async with await connect(
            leader.own_address, FromLeader, trust=trust, as_unknown=as_unknown
        ) as channel:
            await channel.send(message)
            async with asyncio.timeout(60):
                return await channel.receive_header()
    except NetworkError:
        return None


def state(leader: LeaderNode, trust: Trust, sessions: Path) -> Any:
    """What messages could have changed."""
    status = leader.status()
    nodes = [(node.name, node.address, node.disk_free_bytes, node.fps) for node in status.nodes]
    machines = [(machine.pin, machine.roles) for machine in trust.known.all()]
    return nodes, status.burst, status.sessions, machines, sorted(sessions.rglob("*"))


@pytest.mark.parametrize("role", [None, Role.CAMERA])
async def test_no_message_of_who_may_not_send_it_changes_anything(
    role: Role | None, tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    """A stranger, or another camera of the rig; all of it twice, as somebody does who has recorded it."""
    machine = introduced(tmp_path, trust, "machine")
    other = Trust(tmp_path / "other") if role is None else introduced(tmp_path, trust, "other", role)
    async with sealed_node(leader.own_address, machine) as node:
        await until(lambda: node.time.is_member)
        before, refused = state(leader, trust, tmp_path / "sessions"), 0
        for message in every_message(node) * 2:
            said = await answer(leader, other, message, as_unknown=role is None)
            assert said is None or isinstance(said, wire.Refusal), message
            refused += isinstance(said, wire.Refusal)
            assert state(leader, trust, tmp_path / "sessions") == before, message
        assert refused >= 40, "those that are not are broken off"
        await until(lambda: node.time.is_member)


def readable_orders() -> list[tuple[str, Any]]:
    """An operator's messages with each value of each field with which they can still be read, by its path."""
    found = []
    for kind in (one for one in SENDERS[Role.OPERATOR] if one not in STARTS_OR_ENDS):
        info = inspect.type_info(kind)
        for path, plain in attacks(info, example(info)):
            with suppress(msgspec.MsgspecError, ValueError, OverflowError):
                message = msgspec.json.decode(msgspec.json.encode(plain), type=ToLeader)
                if isinstance(message, wire.BurstRequest):
                    # Too far away to be taken.
                    message = msgspec.structs.replace(message, at_leader_ns=2**61)
                found.append((path, message))
    return found


async def test_an_operator_with_any_field_changed_blinds_no_other(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    machine = introduced(tmp_path, trust, "machine")
    operator = introduced(tmp_path, trust, "operator", Role.OPERATOR)
    tried = readable_orders()
    assert len(tried) > 130
    async with (
        joined(leader.own_address, ("cam1", 1), trust=machine),
        await connect(leader.own_address, FromLeader, trust=operator) as channel,
    ):
        await until(lambda: bool(leader.status().nodes))
        for path, message in tried:
            await channel.send(message)
            async with asyncio.timeout(30):
                while isinstance(said := await channel.receive_header(), wire.BurstAnswer):
                    assert not said.burst.done, (path, message)
            assert said is not None, (path, message)
        assert isinstance(await answer(leader, trust, wire.StatusRequest()), wire.StatusAnswer)
        assert len(leader.log.after(0)) < 100


async def test_an_operator_speaks_for_no_camera_and_no_relay(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    machine = introduced(tmp_path, trust, "machine")
    operator = introduced(tmp_path, trust, "operator", Role.OPERATOR)
    async with sealed_node(leader.own_address, machine) as node:
        await until(lambda: node.time.is_member)
        assert isinstance(await answer(leader, operator, wire.StatusRequest()), wire.StatusAnswer)
        for message in every_message(node):
            if isinstance(message, (*SENDERS[Role.CAMERA], *SENDERS[Role.RELAY])):
                said = await answer(leader, operator, message)
                assert said is None or isinstance(said, wire.Refusal), message


def test_the_table_of_rights_has_each_message_to_a_leader_once() -> None:
    listed = [kind for kinds in SENDERS.values() for kind in kinds]
    assert sorted(map(str, listed)) == sorted(map(str, typing.get_args(wire.ToLeader)))


@pytest.mark.parametrize("field", ["seconds", "interval_s", "wait_ready_s"])
def test_a_time_beyond_all_use_is_no_message(field: str) -> None:
    told = msgspec.json.encode({"type": "burst-request", field: 1e308})
    with pytest.raises(msgspec.ValidationError, match=field):
        msgspec.json.decode(told, type=wire.BurstRequest)
