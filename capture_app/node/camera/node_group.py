"""Several cameras of one machine in one process: a node for each, none of which waits for another."""

import asyncio
from collections.abc import Mapping

from capture_app.common.errors import CameraError, ungrouped_errors
from capture_app.node.camera.camera_node import CameraNode
from capture_app.protocol.news import Log

RETRY_S = 5.0


async def run_nodes(nodes: Mapping[str, CameraNode], log: Log, *, retry_s: float = RETRY_S) -> None:
    """Run nodes side by side until cancelled; one without its camera is tried again while others run.

    Raises CameraError where not one camera can be opened at the start, and any other error of a node.
    """
    failed: set[str] = set()

    async def keep(name: str) -> None:
        while True:
            failed.discard(name)
            try:
                await nodes[name].run()
                return
            except CameraError as error:
                failed.add(name)
                if len(failed) == len(nodes):
                    raise
                log.say(f"{name}: {error}; tried again while the others run")
            await asyncio.sleep(retry_s)

    with ungrouped_errors():
        async with asyncio.TaskGroup() as tasks:
            for name in nodes:
                tasks.create_task(keep(name))
