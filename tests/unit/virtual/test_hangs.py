"""A process of a virtual rig that hangs is a failure with its name."""

import asyncio
import contextlib

from tests.virtual.world import World


def test_a_process_that_does_not_end_when_it_is_stopped_fails_by_name() -> None:
    world = World(1)

    async def waits_for_ever() -> None:
        while True:
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(1e6)

    async def evening() -> None:
        world.start("cam0", "cam0", waits_for_ever)
        await asyncio.sleep(1)
        await world.stop("cam0")

    with world.entered():
        world.run(evening())
    world.disks.remove()
    (failure,) = world.failures
    assert failure.endswith(" s: cam0 hangs 20 s after it was stopped")
