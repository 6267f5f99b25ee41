"""What leaders, relays and standbys start, they close again, after a failed start too."""

import asyncio
from pathlib import Path

import pytest

from capture_app.common.address import Address
from capture_app.common.clock import NodeClock
from capture_app.common.errors import NetworkError
from capture_app.net.server import bind_port
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.standby import lead_by_rank
from capture_app.trust.trust import Trust
from tests.waiting import until

pytestmark = pytest.mark.virtual


HERE = "127.0.0.1"


def free_port() -> int:
    bound = bind_port(HERE, 0)
    port = int(bound[0].getsockname()[1])
    for sock in bound:
        sock.close()
    return port


class NotedFollower:
    """A follower that notes what becomes of it, and fails to start if it is to."""

    def __init__(self, noted: list[str], name: str, *, fails: bool = False) -> None:
        self.noted, self.name, self.fails = noted, name, fails

    def start(self, clock: NodeClock) -> None:
        if self.fails:
            raise NetworkError("its port is in use")
        self.noted.append(f"{self.name} started")

    def follow_take(self, take: BurstSession) -> None:
        """There is none."""

    async def close(self) -> None:
        self.noted.append(f"{self.name} closed")


async def start(folder: Path, port: int, followers: list[NotedFollower]) -> LeaderNode:
    options = LeaderOptions(sessions=folder, host=HERE, port=port, trust=Trust.open(), followers=followers)
    return await LeaderNode.start(options)


async def test_a_failed_start_leaves_nothing_behind(tmp_path: Path) -> None:
    before = asyncio.all_tasks()
    noted: list[str] = []
    leader = await start(tmp_path, 0, [NotedFollower(noted, "one")])
    port = leader.address.port
    await leader.stop()
    assert noted == ["one started", "one closed"]
    followers = [NotedFollower(noted, "one"), NotedFollower(noted, "other", fails=True)]
    with pytest.raises(NetworkError, match="its port is in use"):
        await start(tmp_path, port, followers)
    assert noted[2:] == ["one started", "one closed", "other closed"]
    for sock in bind_port(HERE, port):
        sock.close()
    await asyncio.sleep(0)
    assert asyncio.all_tasks() == before


async def test_a_standby_that_stops_says_goodbye(tmp_path: Path) -> None:
    async with await LeaderNode.start(
        LeaderOptions(sessions=tmp_path, host=HERE, port=0, trust=Trust.open())
    ) as leader:
        port = free_port()

        def options() -> LeaderOptions:
            return LeaderOptions(sessions=tmp_path, host=HERE, port=port, trust=Trust.open())

        async def lead(_: LeaderNode) -> None:
            await asyncio.Event().wait()

        leaders = [leader.own_address, Address(HERE, port)]
        standby = asyncio.create_task(lead_by_rank(options, leaders, lead))
        await until(lambda: [node.name for node in leader.status().nodes])
        (name,) = [node.name for node in leader.status().nodes]
        standby.cancel()
        await until(lambda: any("lost" in line.text for line in leader.log.after(0)))
        assert f"lost {name}: it left" in [line.text for line in leader.log.after(0)]
