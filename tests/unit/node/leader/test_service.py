"""Orders and messages that a leader answers: cameras removed, orders of frames, times, and nonsense."""

import asyncio
from collections.abc import AsyncIterator, Collection, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from capture_app.common.camera_facts import PHONE
from capture_app.common.errors import BadInputError, IncompleteError, NotAvailableError
from capture_app.common.stagger import Stagger
from capture_app.net.channel import connect
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.viewfinders import Viewfinders
from capture_app.protocol.messages import BurstRequest, FromLeader, NodeStream, Refusal, ReportAck
from capture_app.protocol.orders import (
    AddCamera,
    AddSimulated,
    AskTime,
    Done,
    InvitePhone,
    PhoneInvited,
    RemoveCamera,
    StaggerCameras,
    TimeAnswer,
)
from capture_app.rig.rig_link import ask_leader
from capture_app.sync.rig.burst_orders import BurstOrder
from tests.cheap_rig import start_leader
from tests.facts import make_facts
from tests.unit.node.bursts import report
from tests.unit.node.joining import joined
from tests.unit.node.test_limits import join_many

pytestmark = [pytest.mark.usefixtures("open_rig"), pytest.mark.virtual]


@pytest.fixture
async def leader(tmp_path: Path) -> AsyncIterator[LeaderNode]:
    async with await start_leader(tmp_path / "sessions") as node:
        yield node


class LocalCameras:
    """The processes of a leader's machine, drawn."""

    def __init__(self) -> None:
        self.specs = {"local": "sim"}
        self.removed: list[str] = []
        self.taken: list[str] = []
        self.phones = self

    async def invitation(self) -> PhoneInvited:
        return PhoneInvited(url="https://a", fingerprint="AB", good_for_s=9)

    async def add_camera(self, spec: str, name: str | None, taken: Collection[str]) -> str:
        self.taken = sorted(taken)
        return f"{name} {spec}"

    async def add_simulated(self, order: AddSimulated, *, taken: Collection[str]) -> tuple[str, ...]:
        self.taken = sorted(taken)
        return ("cam00", "cam01")[: order.cameras]

    async def remove(self, name: str) -> None:
        self.removed.append(name)


@pytest.fixture
def local(leader: LeaderNode) -> Iterator[LocalCameras]:
    leader.service._local = local = LocalCameras()  # type: ignore[assignment]
    yield local
    leader.service._local = None


def names(leader: LeaderNode) -> set[str]:
    return set(leader.engine.roster.members)


def leaves(leader: LeaderNode, name: str) -> None:
    """Let a node sign off, and the leader notice it."""
    leader.engine.drop_member(leader.engine.roster.members[name], "it left")
    leader.service.roster_changed.set()


async def test_cameras_of_this_machine_get_no_name_that_is_taken(
    leader: LeaderNode, local: LocalCameras
) -> None:
    join_many(leader, "", ["here", "lost"])
    leaves(leader, "lost")
    leader.engine.roster.owners["away"] = "pin of another machine"
    leader.engine.roster.owners["own"] = ""
    assert await leader.service.carry_out(AddCamera(spec="sim", name="x")) == Done(names=("x sim",))
    assert local.taken == ["away", "here"]
    local.taken = []
    added = await leader.service.carry_out(AddSimulated(cameras=2))
    assert (added, local.taken) == (Done(names=("cam00", "cam01")), ["away", "here"])


async def test_a_phone_is_invited_by_a_leader_that_runs_cameras(
    leader: LeaderNode, local: LocalCameras
) -> None:
    assert await leader.service.carry_out(InvitePhone()) == await local.invitation()
    leader.service._local = None
    with pytest.raises(NotAvailableError, match="runs no cameras") as refused:
        await leader.service.carry_out(InvitePhone())
    assert refused.value.hint == "run capture-app node on the camera's machine"


async def test_a_camera_of_this_machine_is_removed_once_it_has_left(
    leader: LeaderNode, local: LocalCameras
) -> None:
    join_many(leader, "", ["local"])
    removing = asyncio.ensure_future(leader.service.carry_out(RemoveCamera(name="local")))
    await asyncio.sleep(1.0)
    assert (local.removed, removing.done()) == (["local"], False), "it says goodbye first"
    leaves(leader, "local")
    assert await removing == Done()
    assert "local" not in names(leader)


async def test_a_camera_of_this_machine_that_never_joined_is_removed(
    leader: LeaderNode, local: LocalCameras
) -> None:
    assert await leader.service.carry_out(RemoveCamera(name="local")) == Done()
    assert local.removed == ["local"]


async def test_a_phone_is_told_to_leave_and_forgotten(
    leader: LeaderNode, local: LocalCameras, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []

    async def put_off(_: Viewfinders, name: str) -> None:
        told.append(name)

    monkeypatch.setattr(Viewfinders, "put_off", put_off)
    join_many(leader, "", ["phone", "webcam"])
    leader.engine.roster.members["phone"].camera = make_facts(kind=PHONE)
    removing = asyncio.ensure_future(leader.service.carry_out(RemoveCamera(name="phone")))
    await asyncio.sleep(1.0)
    assert (told, removing.done()) == (["phone"], False)
    leaves(leader, "phone")
    await removing
    assert (names(leader), local.removed) == ({"webcam"}, [])


async def test_a_camera_that_goes_on_is_not_removed(leader: LeaderNode, local: LocalCameras) -> None:
    async with joined(leader.own_address, ("webcam", 1), ("local", 2)):
        with pytest.raises(BadInputError, match=r"webcam runs on 127.0.0.1, not as a process") as refused:
            await leader.service.carry_out(RemoveCamera(name="webcam"))
        assert refused.value.hint == "stop capture-app node there"
        assert local.removed == []
        with pytest.raises(BadInputError, match=r"local runs on 127.0.0.1"):
            await leader.service.carry_out(RemoveCamera(name="local"))
        assert names(leader) == {"webcam", "local"}


async def test_a_lost_camera_is_forgotten(leader: LeaderNode) -> None:
    join_many(leader, "", ["lost"])
    leaves(leader, "lost")
    await leader.service.carry_out(RemoveCamera(name="lost"))
    assert names(leader) == set()


async def test_an_order_of_frames_waits_for_a_burst_that_is_just_over(leader: LeaderNode) -> None:
    async with joined(leader.own_address, ("a", 1), ("b", 2)):
        await leader.service.carry_out(StaggerCameras(order="even"))
        assert leader.engine.current.config.stagger == Stagger.parse("even")
        burst = await leader.bursts.order(BurstOrder(frames=1))
        staggering = asyncio.ensure_future(leader.service.carry_out(StaggerCameras(order="")))
        await asyncio.sleep(0.05)
        assert not staggering.done()
        await leader.bursts.cancel(burst.burst.number)
        await staggering
        assert leader.engine.current.config.stagger is None
        await leader.bursts.order(BurstOrder(frames=10_000, streamed=True))
        with pytest.raises(IncompleteError, match="a burst is under way") as refused:
            await leader.service.carry_out(StaggerCameras(order="even"))
        assert refused.value.hint == "stagger the rig when it is over"


async def test_the_time_of_a_rig_is_told_beside_the_calendar(leader: LeaderNode) -> None:
    before_ns = leader.bursts.now_ns()
    told = await ask_leader(leader.own_address, AskTime(), TimeAnswer)
    assert before_ns <= told.leader_ns <= leader.bursts.now_ns()
    assert told.unix_ns > 1_700_000_000 * 10**9


async def test_a_camera_that_sends_nonsense_is_left_out_of_its_bursts_and_may_go_on(
    leader: LeaderNode,
) -> None:
    async with (
        joined(leader.own_address, ("cam0", 1)),
        await connect(leader.own_address, FromLeader) as channel,
    ):
        taking = leader.bursts.take(BurstRequest(frames=1, spare=0))
        await anext(taking)
        stream = NodeStream(camera="cam0", instance=1)
        await channel.send(stream)
        assert isinstance(await channel.receive_header(), ReportAck)
        await channel.send(Nonsense(camera="cam0"))
        refusal: Any = await channel.receive_header()
        assert isinstance(refusal, Refusal)
        assert refusal.what.startswith("cam0 sent an invalid message: ")
        assert (refusal.what, "warning") in [(line.text, line.level) for line in leader.log.after(0)]
        last = [status async for status in taking][-1]
        assert [of.problem for of in last.transfer] == [
            refusal.what.removeprefix("cam0 ").replace("sent", "it sent", 1)
        ]
        await channel.send(stream)
        assert isinstance(await channel.receive_header(), ReportAck)


async def test_a_camera_whose_stream_has_ended_is_not_awaited_as_if_it_were_open(leader: LeaderNode) -> None:
    async with joined(leader.own_address, ("cam0", 1)):
        taking = leader.bursts.take(BurstRequest(frames=1, spare=0))
        run, number = leader.engine.config.instance, (await anext(taking)).burst
        async with await connect(leader.own_address, FromLeader) as channel:
            for message in (
                NodeStream(camera="cam0", instance=1),
                msgspec.structs.replace(report("cam0", 0), leader=run, burst=number),
            ):
                await channel.send(message)
                assert isinstance(await channel.receive_header(), ReportAck)
        last = [status async for status in taking][-1]
        assert [of.problem for of in last.transfer] == ["it sent nothing"]


class Nonsense(msgspec.Struct, tag="spool-space"):
    camera: str
    free_bytes: str = "much"


async def test_nonsense_of_anybody_else_ends_the_stream(leader: LeaderNode) -> None:
    async with await connect(leader.own_address, FromLeader) as channel:
        await channel.send(Nonsense(camera="cam0"))
        assert await channel.receive_header() is None
