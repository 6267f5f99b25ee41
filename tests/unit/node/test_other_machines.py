"""A paired camera against everybody else: each message and stream as another's names, bursts and keys."""

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import connect
from capture_app.node.burst import camera_delivery
from capture_app.node.endpoint import PortOptions
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.relay_node import RelayNode
from capture_app.protocol import messages as wire
from capture_app.protocol.messages import FromLeader, Refusal
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.wire.datagrams import JoinRefusal
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced
from tests.unit.node.test_all_messages import every_message
from tests.unit.node.thieves import FORGERY, ask, image, report, say_hello
from tests.waiting import until

pytestmark = pytest.mark.virtual

CAM, OWN = ("cam", 1111), ("mine", 2222)
INSTANTS = range(3)
FOREVER_NS = 3600 * 10**9


@dataclass
class Field:
    """A rig with a burst of `cam` under way, whose machine is there or not, and a paired thief."""

    leader: LeaderNode
    near: Address
    """Where the thief, and the owner, join: the leader or a relay of it."""
    thief: Trust
    burst: tuple[int, int]
    sessions: Path
    others: tuple[Trust, ...]

    def state(self) -> Any:
        """All that belongs to others and that messages could have changed."""
        status = self.leader.status()
        nodes = [
            (n.name, n.parent, n.camera, n.fps, n.exposure_ns, n.disk_free_bytes, n.state == "lost")
            for n in status.nodes
            if n.name != OWN[0]
        ]
        files = {path: path.stat().st_size for path in sorted(self.sessions.rglob("*")) if path.is_file()}
        machines = [[(m.pin, m.roles) for m in trust.known.all()] for trust in self.others]
        burst = status.burst and (status.burst.received, status.burst.done, status.burst.transfer)
        grid = self.leader.engine.grid
        return nodes, burst, status.sessions, files, machines, grid and grid.period_ns


@pytest.fixture(params=["the leader", "a relay"])
def below_relay(request: pytest.FixtureRequest) -> bool:
    return bool(request.param == "a relay")


@pytest.fixture(params=["running", "restarted, the owner away"])
def restarted(request: pytest.FixtureRequest) -> bool:
    return bool(request.param != "running")


@pytest.fixture
async def field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, below_relay: bool, restarted: bool
) -> AsyncIterator[Field]:
    # Nothing comes from the camera: were it given up meanwhile, the state would change without any message.
    monkeypatch.setattr(camera_delivery, "CAMERA_DISCONNECTED_NS", FOREVER_NS)
    trust, relay = Trust(tmp_path / "leader"), Trust(tmp_path / "relay")
    home = relay if below_relay else trust
    owner, thief = (introduced(tmp_path, home, name) for name in ("owner", "thief"))
    one, other = relay.identity, trust.identity
    relay.known.add(other.pin, Role.LEADER, name="leader", certificate=other.certificate)
    trust.known.add(one.pin, Role.RELAY, name="relay", certificate=one.certificate)
    sessions = tmp_path / "sessions"
    burst = 0, 0
    for turn in range(1 + restarted):
        async with AsyncExitStack() as stack:
            leader = await stack.enter_async_context(await start_leader(sessions, trust=trust))
            near = leader.own_address
            if below_relay:
                options = PortOptions(host="127.0.0.1", port=0, trust=relay)
                near = (
                    await stack.enter_async_context(await RelayNode.start("hall", (near,), options))
                ).address
            if turn == 0:
                await stack.enter_async_context(joined(near, CAM, trust=owner))
                await seen(leader, "cam")
                session = await leader.bursts.order(BurstOrder(frames=len(INSTANTS)))
                burst = leader.instance, session.burst.number
            if turn == restarted:
                await stack.enter_async_context(joined(near, OWN, trust=thief))
                await seen(leader, "mine")
                if turn:
                    await until(leader.bursts.resumed.sessions)
                yield Field(leader, near, thief, burst, sessions, (trust, relay))


async def seen(leader: LeaderNode, name: str) -> None:
    """Wait for a member; one below a relay is confirmed by what it says after its hello."""
    members = leader.engine.roster.members
    await until(lambda: name in members and members[name].is_confirmed)


def as_the_camera(field: Field) -> Iterator[Any]:
    """Every message, made up by who knows the camera's name and run, and the burst."""
    names = type("Known", (), {"name": CAM[0], "instance": CAM[1]})
    yield from every_message(names)  # type: ignore[arg-type]
    yield report("cam", *field.burst, INSTANTS)
    for instant in INSTANTS:
        yield image("cam", *field.burst, instant)


OPENINGS: dict[str, Callable[[], tuple[Any, ...]]] = {
    "at once": lambda: (),
    "on its own image stream": lambda: (wire.NodeStream(camera=OWN[0], instance=OWN[1]),),
    "on its own viewfinder": lambda: (wire.NodeStream(camera=OWN[0], instance=OWN[1], shows=True),),
}


@pytest.mark.parametrize("opening", OPENINGS)
async def test_no_message_of_a_paired_camera_changes_what_is_anothers(field: Field, opening: str) -> None:
    before = field.state()
    for message in as_the_camera(field):
        try:
            async with await connect(field.near, FromLeader, trust=field.thief) as channel:
                for first in OPENINGS[opening]():
                    await channel.send(first)
                    if isinstance(first, wire.NodeStream) and not first.shows:
                        assert isinstance(await channel.receive_header(), wire.ReportAck)
                payload = FORGERY if isinstance(message, wire.ImageBatch) else b""
                said = None
                if opening == "on its own viewfinder":
                    await channel.send(message, payload)  # nobody answers there
                else:
                    said = await ask(channel, message, payload)
                assert said is None or isinstance(said, Refusal), (message, said)
        except NetworkError:
            pass
        assert field.state() == before, message


async def test_no_run_of_a_paired_camera_joins_under_anothers_name(field: Field) -> None:
    before = field.state()
    for run in (CAM[1], 3333, 4444):
        for _ in range(2):
            said = await say_hello(field.near, field.thief, CAM[0], run)
            # A relay that has just been started must ask its leader first.
            assert isinstance(said, JoinRefusal | None) or field.near != field.leader.own_address, said
            for message in (report("cam", *field.burst, INSTANTS), image("cam", *field.burst, 0)):
                async with await connect(field.near, FromLeader, trust=field.thief) as channel:
                    first = await ask(channel, wire.NodeStream(camera="cam", instance=run))
                    assert isinstance(first, Refusal), first
                    payload = FORGERY if isinstance(message, wire.ImageBatch) else b""
                    assert isinstance(await ask(channel, message, payload), Refusal | None)
            assert field.state() == before, run
        assert isinstance(said, JoinRefusal | None), said
