"""What one paired machine can take up: its own share, and no room, rate or picture of others."""

import asyncio
import resource
import sys
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from capture_app.common.errors import NetworkError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import connect
from capture_app.net.server import MAX_STREAMS_PER_MACHINE
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol import messages as wire
from capture_app.protocol import orders
from capture_app.protocol.messages import FromLeader, NodeStream, StatusAnswer
from capture_app.trust.trust import Trust
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced
from tests.unit.node.test_limits import OWN
from tests.unit.node.thieves import ask
from tests.waiting import SLOW_PATIENCE_S, until

MIB = 1 << 20


def memory_bytes() -> int:
    """The most that this process has taken until now."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


SENDER = """
import asyncio, sys
from pathlib import Path
from capture_app.common.address import Address
from capture_app.net.channel import connect
from capture_app.protocol import orders
from capture_app.protocol.messages import FromLeader, NodeStream
from capture_app.protocol.status import Preview
from capture_app.trust.trust import Trust

async def send(trust, leader):
    channels = []
    for n in range(8):
        name = f"mine{n}"
        channels.append(channel := await connect(leader, FromLeader, trust=trust))
        await channel.send(NodeStream(camera=name, instance=n + 1, shows=True))
        frame = Preview(camera=name, leader_ns=0, width=1, height=1)
        await channel.send(frame, bytes(24 << 20))
        await channel.send(orders.CameraHealth(fps=7.0))
    await asyncio.sleep(600)

asyncio.run(send(Trust(Path(sys.argv[1])), Address("127.0.0.1", int(sys.argv[2]))))
"""


@pytest.mark.virtual
async def test_streams_of_one_machine_leave_room_for_operators_and_others(
    tmp_path: Path, trust: Trust, leader: LeaderNode
) -> None:
    """766 of them locked everybody out."""
    machine, other = introduced(tmp_path, trust, "machine"), introduced(tmp_path, trust, "other")
    operator = introduced(tmp_path, trust, "operator", Role.OPERATOR)
    loop = asyncio.get_running_loop()
    async with AsyncExitStack() as stack, joined(leader.own_address, OWN, trust=machine):
        kept = 0
        for _ in range(MAX_STREAMS_PER_MACHINE + 40):
            try:
                channel = await stack.enter_async_context(
                    await connect(leader.own_address, FromLeader, trust=machine)
                )
                opened = NodeStream(camera=OWN[0], instance=OWN[1], shows=True)
                await channel.send(opened)
                kept += 1
            except NetworkError:
                continue
        began_s = loop.time()
        async with await connect(leader.own_address, FromLeader, trust=operator) as channel:
            assert isinstance(await ask(channel, wire.StatusRequest()), StatusAnswer)
        async with joined(leader.own_address, ("cam", 1), trust=other):
            pass
        assert loop.time() - began_s < 30, "an answer all the same"


@pytest.mark.parametrize("wanted", [False, True], ids=["unasked", "far too large"])
async def test_pictures_that_nobody_wants_take_no_memory(
    tmp_path: Path, trust: Trust, leader: LeaderNode, wanted: bool
) -> None:
    """Eight of them took 513 MB."""
    machine = introduced(tmp_path, trust, "machine")
    names = [f"mine{n}" for n in range(8)]
    async with AsyncExitStack() as stack:
        for n, name in enumerate(names):
            await stack.enter_async_context(joined(leader.own_address, (name, n + 1), trust=machine))
        if wanted:
            operator = introduced(tmp_path, trust, "operator", Role.OPERATOR)
            watching = await connect(leader.own_address, FromLeader, trust=operator)
            await stack.enter_async_context(watching)
            await watching.send(orders.WatchRequest())
            await watching.send(orders.PreviewRequest(width=160, fps=1.0))
        before = memory_bytes()
        where = str(tmp_path / "machine"), str(leader.own_address.port)
        process = await asyncio.create_subprocess_exec(sys.executable, "-c", SENDER, *where)
        try:
            await until(
                lambda: all(n.fps == 7.0 for n in leader.status().nodes if n.name in names),
                seconds=SLOW_PATIENCE_S,
            )
            grown = memory_bytes() - before
        finally:
            process.kill()
            await process.wait()
    # Of 192 MiB that were sent.
    assert grown < 100 * MIB, f"{grown / MIB:.0f} MiB"
