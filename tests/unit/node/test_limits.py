"""What one paired machine can take up: its own share, and no room, rate or picture of others."""

from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest

from capture_app.common.camera_facts import StampAccuracy, StampSource
from capture_app.common.errors import DiskFullError
from capture_app.common.node_state import NodeState
from capture_app.net.channel import MAX_HEADER_BYTES, connect
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.snapshots import MAX_PER_PAGE, fitted_burst
from capture_app.protocol import messages as wire
from capture_app.protocol import orders
from capture_app.protocol.messages import BurstRequest, FromLeader, NodeStream, SpoolSpace, StatusAnswer
from capture_app.protocol.status import BurstStatus, CameraTransfer
from capture_app.rig.rig_link import ask_status
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.roster import MAX_CAMERAS_PER_MACHINE
from capture_app.sync.wire.codec import encode
from capture_app.sync.wire.datagrams import Heartbeat, Hello, Principal, Report, Welcome
from capture_app.trust.trust import Trust
from tests.facts import make_facts
from tests.unit.node.camera.controlled_camera import StillClock
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced
from tests.unit.node.thieves import ask, say_hello
from tests.waiting import until

OWN = ("mine", 2222)
SLOW = 1_000_000_000


LONG = "\N{GRINNING FACE}" * 200


def join_many(
    leader: LeaderNode, pin: str, names: list[str], period_ns: int = 33_333_333, message: str = ""
) -> None:
    """Let one machine's nodes say hello and a first word, as their keys would let them."""
    engine = leader.engine
    for instance, name in enumerate(names, 1):
        who, now_ns = Principal(name, instance, pin), leader.bursts.now_ns()
        address = ("127.0.0.1", 1 + instance)
        engine.receive_datagram(
            encode(Hello(name, instance, make_facts(period_ns=period_ns))), address, now_ns, who
        )
        member = engine.roster.members.get(name)
        if member is not None and member.instance == instance:
            report = Heartbeat(member.number, Report(state=NodeState.READY, message=message))
            engine.receive_datagram(encode(report), address, now_ns, who)
    engine.handle_timer(leader.bursts.now_ns())
    list(engine.datagrams_to_send(leader.bursts.now_ns()))


@pytest.mark.virtual
async def test_one_machine_has_so_many_names_and_others_still_join(
    tmp_path: Path, trust: Trust, leader: LeaderNode
) -> None:
    """It took 10,500 in 37 s, and nobody could be let in."""
    join_many(leader, "pin-of-one", [f"made-up-{n}" for n in range(3000)])
    assert len(leader.status().nodes) == MAX_CAMERAS_PER_MACHINE
    assert isinstance(await say_hello(leader.own_address, introduced(tmp_path, trust, "x"), *OWN), Welcome)
    assert "mine" in {node.name for node in leader.status().nodes}
    # What it leaves goes first when it comes under further names: it keeps to its share.
    await until(lambda: all(node.state is NodeState.LOST for node in leader.status().nodes))
    join_many(leader, "pin-of-one", [f"later-{n}" for n in range(300)])
    nodes = leader.status().nodes
    assert len(nodes) == MAX_CAMERAS_PER_MACHINE + 1
    assert sum(node.name.startswith("later") for node in nodes) == MAX_CAMERAS_PER_MACHINE


@pytest.fixture
async def still_leader(tmp_path: Path, trust: Trust) -> AsyncIterator[LeaderNode]:
    """A leader whose time stands still: nobody is lost while a thousand cameras join."""
    options = LeaderOptions(
        sessions=tmp_path / "sessions", host="127.0.0.1", port=0, trust=trust, clock=StillClock()
    )
    async with await LeaderNode.start(options) as node:
        yield node


async def test_the_status_of_a_large_rig_comes_in_pages_and_fits_a_message(
    trust: Trust, still_leader: LeaderNode
) -> None:
    leader = still_leader
    for machine in range(10):
        names = [f"cam-{machine}-{n:03d}-{'n' * 40}" for n in range(MAX_CAMERAS_PER_MACHINE)]
        join_many(leader, f"pin-{machine}", names)
    async with await connect(leader.own_address, FromLeader, trust=trust) as channel:
        answer = await ask(channel, wire.StatusRequest())
        assert isinstance(answer, StatusAnswer)
        assert len(msgspec.json.encode(answer)) < MAX_HEADER_BYTES // 2
        assert (len(answer.rig.nodes), answer.rig.further) == (MAX_PER_PAGE, 1000 - MAX_PER_PAGE)
        assert answer.rig.message == f"and {1000 - MAX_PER_PAGE} more nodes, not listed here: 750 ready"
        await channel.send(orders.WatchRequest())
        told = await channel.receive_header()
        assert isinstance(told, StatusAnswer)
        assert told.rig.further == 1000 - MAX_PER_PAGE
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trust, "of_user", classmethod(lambda _: trust))
        rig = await ask_status(leader.own_address)
    assert [node.name for node in rig.nodes] == sorted(leader.engine.roster.members)
    assert (rig.further, rig.message) == (0, "")


async def test_nodes_with_long_texts_leave_a_status_that_operators_get(
    trust: Trust, leader: LeaderNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    """250 of them ended each operator's stream without a word."""
    monkeypatch.setattr(Trust, "of_user", classmethod(lambda _: trust))
    for machine in range(3):
        names = [f"cam-{machine}-{n:03d}" for n in range(MAX_CAMERAS_PER_MACHINE)]
        join_many(leader, f"pin-{machine}", names, message=LONG)
    # What else a status has of a node is as long, and comes by streams.
    stamp = StampAccuracy(bias_ns=0, uncertainty_ns=1, source=StampSource.LIGHT, against=LONG)
    for member in leader.engine.roster.members.values():
        member.camera = make_facts(kind=LONG, model=LONG, pixel_format=LONG, stamp=stamp)
    async with await connect(leader.own_address, FromLeader) as channel:
        await channel.send(orders.WatchRequest())
        told = await channel.receive_header()
        assert isinstance(told, StatusAnswer)
        assert len(told.rig.nodes) + told.rig.further == 300
        assert f"and {told.rig.further} more nodes, not listed here" in told.rig.message
    assert len((await ask_status(leader.own_address)).nodes) == 300


async def test_a_burst_of_cameras_with_long_problems_is_reported_without_their_list() -> None:
    transfer = tuple(
        CameraTransfer(camera=f"cam{n}", received=0, expected=1, problem="x" * 200) for n in range(2000)
    )
    status = BurstStatus(
        burst=1, name="b", cameras=2000, instants=1, received=0, expected=2000, message="y" * 10**6,
        transfer=transfer,
    )  # fmt: skip
    sent = fitted_burst(status)
    assert len(msgspec.json.encode(sent)) < 10_000
    assert sent.message.endswith("too long to be listed")
    few = msgspec.structs.replace(status, transfer=transfer[:10], message="")
    assert fitted_burst(few) == few


async def test_a_status_that_fits_no_message_is_an_error_that_says_so(
    trust: Trust, leader: LeaderNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def keep() -> None:
        """No disk has a path as long."""

    monkeypatch.setattr(leader.bursts, "forget_moved", keep)
    leader.bursts.saved.append("/" + "x" * MAX_HEADER_BYTES)
    async with await connect(leader.own_address, FromLeader, trust=trust) as channel:
        for request in (wire.StatusRequest(), orders.WatchRequest()):
            answer = await ask(channel, request)
            assert isinstance(answer, wire.Refusal)
            assert "too large to send" in answer.what
            assert answer.hint


async def test_a_machine_has_one_vote_on_the_rate_however_many_cameras_it_makes_up(
    trust: Trust, leader: LeaderNode
) -> None:
    for machine in range(2):
        join_many(leader, f"honest-{machine}", [f"cam{machine}"])
    join_many(leader, "pin-of-one", [f"slow{n}" for n in range(5)], period_ns=SLOW)
    grid = leader.engine.grid
    assert grid is not None
    assert grid.period_ns == 33_333_333
    # Of one machine alone most cameras decide, as ever.
    for name in ("cam0", "cam1"):
        leader.engine.drop_member(leader.engine.roster.members[name], "away")
    leader.engine.handle_timer(leader.bursts.now_ns())
    grid = leader.engine.grid
    assert grid is not None
    assert grid.period_ns == SLOW


async def test_a_camera_without_room_is_left_out_and_named(
    tmp_path: Path, trust: Trust, leader: LeaderNode
) -> None:
    """ "0 bytes free" of one refused every burst."""
    machine, other = introduced(tmp_path, trust, "machine"), introduced(tmp_path, trust, "other")
    async with (
        joined(leader.own_address, OWN, trust=machine),
        joined(leader.own_address, ("cam", 1), trust=other),
        await connect(leader.own_address, FromLeader, trust=machine) as channel,
    ):
        await ask(channel, NodeStream(camera=OWN[0], instance=OWN[1]))
        await ask(channel, SpoolSpace(camera=OWN[0], free_bytes=0, spool="/full"))
        burst = await leader.bursts.order(BurstOrder(frames=2))
        assert burst.burst.clients == ("cam",)
        assert "without mine: it may need" in burst.status.message
        await leader.bursts.cancel(burst.burst.number)
    await until(lambda: all(node.state is NodeState.LOST for node in leader.status().nodes))
    async with joined(leader.own_address, OWN, trust=machine):
        with pytest.raises(DiskFullError, match="mine: it may need"):
            async for _ in leader.bursts.take(BurstRequest(frames=2)):
                pass
