"""Rigs of a test's own process in virtual time: `pytestmark = pytest.mark.virtual`.

Such tests wait for nothing: leader, nodes and operators run on a loop whose clock jumps to the next timer,
over a network in memory, and what they would do in threads happens on it. Files are real. They may not start
processes or open sockets outside of a coroutine.
"""

import asyncio
import contextlib
import random

from tests.virtual.world import Process, VirtualLoop, World, process

HERE = "127.0.0.1"


class _OwnLoop(VirtualLoop):
    """Loop whose world is in force until it is closed; all that runs on it is one process of one machine."""

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self._undo = contextlib.ExitStack()
        self._undo.callback(world.disks.remove)
        self._undo.callback(process.reset, process.set(Process("test", HERE, 1, random.Random(0))))
        self._undo.enter_context(world.entered())

    def close(self) -> None:
        if not self.is_closed():
            super().close()
            self._undo.close()


def virtual_loop() -> asyncio.AbstractEventLoop:
    """Return a loop in virtual time, which begins now."""
    world = World(0)
    world.loop.close()
    world.network.machine_at(HERE)
    world.loop = _OwnLoop(world)
    return world.loop
