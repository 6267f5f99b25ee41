"""A leader and cheap simulated cameras over loopback, in this process."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from typing import Any

from capture_app.cameras.specs import open_camera
from capture_app.common.address import Address
from capture_app.common.clock import HostClock
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions


@contextlib.asynccontextmanager
async def rig_of(cameras: int, sessions: Path, **options_of_nodes: Any) -> AsyncIterator[LeaderNode]:
    """A leader and so many cheap cameras, in this process."""
    options = LeaderOptions(sessions=sessions, host="127.0.0.1", port=0)
    async with (
        await LeaderNode.start(options) as leader,
        cheap_cameras(cameras, leader.own_address, **options_of_nodes),
    ):
        yield leader


@contextlib.asynccontextmanager
async def cheap_cameras(cameras: int, leader: Address, **options: Any) -> AsyncIterator[None]:
    """So many cheap cameras of any leader, in this process."""
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
        for name in (f"cam{number:02d}" for number in range(cameras))
    ]
    running = [asyncio.ensure_future(node.run()) for node in nodes]
    try:
        yield
    finally:
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
