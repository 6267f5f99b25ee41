"""A leader and cheap simulated cameras over loopback, in this process."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from capture_app.cameras.specs import open_camera
from capture_app.common.address import Address
from capture_app.common.clock import HostClock
from capture_app.common.node_state import NodeState
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.messages import BurstRequest
from capture_app.rig.rig_link import RigLink
from capture_app.session.reading.array_access import OpenSession, open_session
from tests.waiting import until


async def start_leader(sessions: Path, *, port: int = 0, **options: Any) -> LeaderNode:
    """Start a leader of this machine alone, on any free port or this one, until the end of `async with`."""
    return await LeaderNode.start(LeaderOptions(sessions=sessions, host="127.0.0.1", port=port, **options))


@contextlib.asynccontextmanager
async def rig_of(cameras: int, sessions: Path, **options_of_nodes: Any) -> AsyncIterator[LeaderNode]:
    """A leader and so many cheap cameras, in this process."""
    async with (
        await start_leader(sessions) as leader,
        cheap_cameras(cameras, leader.own_address, **options_of_nodes),
    ):
        yield leader


@contextlib.asynccontextmanager
async def cheap_cameras(cameras: int | Sequence[str], leader: Address, **options: Any) -> AsyncIterator[None]:
    """So many cheap cameras of any leader, or cameras of these names, in this process."""
    names = [f"cam{number:02d}" for number in range(cameras)] if isinstance(cameras, int) else cameras
    nodes = [
        CameraNode(
            NodeOptions(
                name=name,
                open_camera=partial(
                    open_camera, "sim:perfect,scale=0.1,drops=0", clock=HostClock(), name=name
                ),
                leaders=(leader,),
                **options,
            )
        )
        for name in names
    ]
    running = [asyncio.ensure_future(node.run()) for node in nodes]
    try:
        yield
    finally:
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)


@contextlib.asynccontextmanager
async def ready_rig(options: LeaderOptions, names: Sequence[str]) -> AsyncIterator[LeaderNode]:
    """A leader with these options and cheap cameras of these names, once all are ready."""
    async with await LeaderNode.start(options) as leader, cheap_cameras(names, leader.own_address):
        await until(lambda: [node.state for node in leader.status().nodes] == [NodeState.READY] * len(names))
        yield leader


async def take_session(leader: LeaderNode, request: BurstRequest) -> OpenSession:
    """Take a burst with a leader's rig, and open its session."""
    statuses = [status async for status in RigLink(leader.own_address).burst(request)]
    assert statuses[-1].session is not None
    return open_session(statuses[-1].session)
