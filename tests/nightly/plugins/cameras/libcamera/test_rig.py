"""Four nodes of libcamera cameras below a leader: aligned by frame durations, and held.

Simulated: the driver, supervisors, clients and leader are the program's own, the library is a double, the
link a drawn one, the time virtual. The rows are not known at the start, crystals run up to 90 ppm apart, and
each camera has an exposure of its own: judged is when their first rows began to be exposed, in truth.
"""

from statistics import median, quantiles

import pytest

from tests.system.plugins.cameras.libcamera.test_rig import four_nodes, held_ns
from tests.unit.plugins.cameras.sim.simulation_driver.stepped import in_stepped_time


@pytest.mark.timeout(3600)
@in_stepped_time
async def test_they_are_held_to_30_us_for_an_hour() -> None:
    async with four_nodes() as rig:
        spreads_ns = await held_ns(rig, 3600)
    share = quantiles(spreads_ns, n=100)
    middle, most = median(spreads_ns), max(spreads_ns)
    print(f"us apart: median {middle / 1e3:.1f}, p95 {share[94] / 1e3:.1f}, most {most / 1e3:.1f}")
    assert middle < 20_000
    assert share[98] < 30_000
