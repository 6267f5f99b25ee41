"""Several cameras of one machine in one process: a node for each, none of which waits for another."""

import asyncio
from collections.abc import Mapping

from capture_app.errors import CameraError, ungrouped_errors
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.news import Log

RETRY_S = 5.0


class NodeGroup:
    """Runs nodes side by side; one whose camera is missing at the start is tried again while others run."""

    def __init__(self, nodes: Mapping[str, CameraNode], log: Log, *, retry_s: float = RETRY_S) -> None:
        self._nodes, self._log = nodes, log
        self._retry_s = retry_s
        self._failed: set[str] = set()
        """The nodes that wait for their next try."""

    async def run(self) -> None:
        """Run all of them until cancelled.

        Raises CameraError where not one camera can be opened at the start, and any other error of a node.
        """
        with ungrouped_errors():
            async with asyncio.TaskGroup() as tasks:
                for name in self._nodes:
                    tasks.create_task(self._keep(name))

    async def _keep(self, name: str) -> None:
        while True:
            self._failed.discard(name)
            try:
                await self._nodes[name].run()
                return
            except CameraError as error:
                self._failed.add(name)
                if len(self._failed) == len(self._nodes):
                    raise
                self._log.say(f"{name}: {error}; tried again while the others run")
            await asyncio.sleep(self._retry_s)
