"""Rigs with clocks that no ordinary crystal has: virtual machines, and hosts that are being slewed."""

import pytest

from capture_app.clock import SimulatedClock
from capture_app.simulation.devices.profiles import PROFILES
from capture_app.simulation.network.paper_link import PAPER_LINK
from capture_app.simulation.rig.rig import NodeSpec
from tests.simulation.rig.rigs import S, ready_rig

SKEWS_PPM = (-35.0, 12.0, 40.0, 130.0, 200.0)


@pytest.mark.parametrize("profile", ["pi", "phone-a"])
def test_two_fast_clocks_in_a_rig_of_five_cost_no_accuracy(profile: str) -> None:
    """As `make bench-rig` with real processes, over the paper's link."""
    specs = [
        NodeSpec(f"cam{n}", PROFILES[profile], SimulatedClock((n - 2) * 3600 * S, ppm), PAPER_LINK, 150_000)
        for n, ppm in enumerate(SKEWS_PPM)
    ]
    rig = ready_rig(specs, seed=1, limit_s=60)
    totals_ns = []
    for _ in range(8):
        rig.run_for(S)
        burst = rig.trigger(frames=2)
        rig.run_for(2 * S)
        for node in rig.nodes.values():
            for pick in node.bursts[burst.number].picks:
                # A driver's late stamp is an error of its own, and is told as such.
                clock_ns = pick.leader_ns - (pick.frame.timestamp_true_ns - pick.outlier_ns)
                assert abs(clock_ns) <= pick.hard_bound_ns
                totals_ns.append(abs(pick.frame.start_true_ns - burst.instants_ns[pick.instant]))
    assert len(totals_ns) > 0.98 * 8 * 2 * len(specs)
    assert max(totals_ns) < 150_000
