"""What a relay that speaks for a machine has looked at is all that it may say: over real UDP and TLS."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import Channel, connect
from capture_app.node.leader.leader import LeaderNode
from capture_app.node.leader.options import LeaderOptions
from capture_app.node.relay import RelayNode, RelayOptions
from capture_app.protocol.messages import FromLeader, NodeStream, Refusal, ReportAck, SpoolSpace
from capture_app.trust.trust import Trust
from tests.node.joining import joined
from tests.node.sealed_nodes import introduced
from tests.waiting import until

RUNS = {"cam0": 1111, "cam1": 2222}
"""The names and runs of two cameras: anybody in the network can read them in their datagrams."""


@asynccontextmanager
async def relays(folder: Path, depth: int) -> AsyncIterator[tuple[LeaderNode, RelayNode, Trust]]:
    """A leader and so many relays below each other; the last one, and its trust."""
    trust = Trust(folder / "leader")
    async with await LeaderNode.start(
        LeaderOptions(sessions=folder / "sessions", host="127.0.0.1", port=0, trust=trust)
    ) as leader:
        own = introduced(folder, trust, "relay-1", Role.RELAY)
        async with await relay("relay-1", leader.own_address, own) as first:
            if depth == 1:
                yield leader, first, own
                return
            below = introduced(folder, own, "relay-2", Role.RELAY)
            async with await relay("relay-2", first.address, below) as second:
                yield leader, second, below


async def relay(name: str, parent: Address, trust: Trust) -> RelayNode:
    return await RelayNode.start(
        RelayOptions(name=name, parents=(parent,), host="127.0.0.1", port=0, trust=trust)
    )


async def ask(channel: Channel[Any], message: Any) -> Any:
    await channel.send(message)
    return await channel.receive_header()


@pytest.mark.parametrize("depth", [1, 2])
async def test_a_camera_below_a_relay_speaks_for_no_other_of_that_relay(tmp_path: Path, depth: int) -> None:
    """Neither at once nor later on a stream which its relay passes on unread."""
    async with relays(tmp_path, depth) as (leader, near, trust):
        machines = {name: introduced(tmp_path, trust, name) for name in RUNS}
        nodes = [joined(near.address, (name, RUNS[name]), trust=machines[name]) for name in RUNS]
        async with nodes[0], nodes[1]:
            await until(lambda: {*RUNS} <= {node.name for node in leader.status().nodes})
            for first in (
                None,
                NodeStream(camera="cam1", instance=RUNS["cam1"]),
                SpoolSpace(camera="cam1", free_bytes=1, spool="x"),
            ):
                for shows in (False, True):
                    where = near.address
                    async with await connect(where, FromLeader, trust=machines["cam1"]) as channel:
                        if first is not None:
                            assert await ask(channel, first) is not None
                        said = await ask(
                            channel, NodeStream(camera="cam0", instance=RUNS["cam0"], shows=shows)
                        )
                        assert isinstance(said, Refusal), (first, shows)
            async with await connect(near.address, FromLeader, trust=machines["cam0"]) as channel:
                own = NodeStream(camera="cam0", instance=RUNS["cam0"])
                assert isinstance(await ask(channel, own), ReportAck)
