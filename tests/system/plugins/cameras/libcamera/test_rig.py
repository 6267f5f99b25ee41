"""Four nodes of libcamera cameras below a leader: aligned by frame durations, and held.

Simulated: the driver, supervisors, clients and leader are the program's own, the library is a double, the
link a drawn one, the time virtual. The rows are not known at the start, crystals run up to 90 ppm apart, and
each camera has an exposure of its own: judged is when their first rows began to be exposed, in truth.
"""

import asyncio
from statistics import median, quantiles

from capture_app.common.node_state import NodeState
from tests.unit.plugins.cameras.libcamera.double_camera import Sensor
from tests.unit.plugins.cameras.libcamera.rig import NodeSpec, Rig
from tests.unit.plugins.cameras.sim.simulation_driver.stepped import HOUR_NS, LoopClock, in_stepped_time
from tests.unit.sync.rig.rigs import LAN

CRYSTALS_PPM = (0.0, 25.0, -30.0, 60.0)
TOLERANCE_NS = 30_000


def four_nodes() -> Rig:
    specs = [
        NodeSpec(
            Sensor(ppm=ppm, exposure_us=5_000 + 1_500 * number, seed=number),
            LoopClock(HOUR_NS * (number + 2), 2 * ppm),
        )
        for number, ppm in enumerate(CRYSTALS_PPM)
    ]
    return Rig(specs, LAN, seed=3, tolerance_ns=TOLERANCE_NS)


async def held_ns(rig: Rig, seconds: int) -> list[int]:
    """The spreads at all instants of so long a time, once the rig is ready."""
    for _ in range(300):
        await asyncio.sleep(0.1)
        if rig.all_ready:
            break
    assert rig.all_ready, [node.client.state for node in rig.nodes]
    rig.spreads_ns()
    spreads: list[int] = []
    for _ in range(seconds // 10):
        await asyncio.sleep(10)
        spreads += rig.spreads_ns()
    assert len(spreads) > 29 * seconds
    assert [node.client.state for node in rig.nodes] == [NodeState.READY] * 4
    assert not rig.said
    return spreads


@in_stepped_time
async def test_four_nodes_are_aligned_to_30_us_though_no_row_was_known() -> None:
    async with four_nodes() as rig:
        spreads_ns = await held_ns(rig, 20)
    assert median(spreads_ns) < 20_000
    assert quantiles(spreads_ns, n=100)[94] < 30_000
