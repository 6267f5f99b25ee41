"""Rigs with clocks that no ordinary crystal has: virtual machines, and hosts that are being slewed."""

from dataclasses import dataclass

import pytest

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.timekeeping.clock_events import ClockChanged
from tests.unit.sync.rig.rigs import LAN, S, checked_error_ns, ready_rig

SKEWS_PPM = (-35.0, 12.0, 40.0, 130.0, 200.0)


@pytest.mark.parametrize("profile", ["pi", "phone-a"])
def test_two_fast_clocks_in_a_rig_of_five_cost_no_accuracy(profile: str) -> None:
    """As `make bench NAME=rig` with real processes, over the paper's link."""
    specs = [
        NodeSpec(f"cam{n}", PROFILES[profile], SimulatedClock((n - 2) * 3600 * S, ppm), PAPER_LINK, 100_000)
        for n, ppm in enumerate(SKEWS_PPM)
    ]
    rig = ready_rig(specs, seed=1, limit_s=60)
    totals_ns = []
    for _ in range(8):
        rig.run_for(S)
        burst = rig.trigger(frames=2)
        rig.run_for(2 * S)
        for node in rig.nodes.values():
            for pick in node.bursts[burst.number].frames:
                # A driver's late stamp is an error of its own, and is told as such.
                clock_ns = pick.leader_ns - (pick.frame.timestamp_true_ns - pick.outlier_ns)
                assert abs(clock_ns) <= pick.hard_bound_ns
                totals_ns.append(abs(pick.frame.start_true_ns - burst.instants_ns[pick.instant]))
    assert len(totals_ns) > 0.95 * 8 * 2 * len(specs)  # a sensor drops one frame in a hundred
    assert max(totals_ns) < 150_000


@dataclass(frozen=True)
class SlewedClock:
    """A clock that an NTP daemon makes faster from one true time on until another; times in ns."""

    offset_ns: int
    ppm: int
    from_true_ns: int
    until_true_ns: int

    def local_from_true(self, true_ns: int) -> int:
        slewed_ns = max(0, min(true_ns, self.until_true_ns) - self.from_true_ns)
        return true_ns + self.offset_ns + slewed_ns * self.ppm // 1_000_000

    def true_from_local(self, local_ns: int) -> int:
        true_ns = local_ns - self.offset_ns
        for _ in range(4):
            true_ns += local_ns - self.local_from_true(true_ns)
        return true_ns

    def now_ns(self) -> int:
        raise NotImplementedError


def test_a_clock_that_is_slewed_while_it_is_watched_is_noticed_at_both_ends() -> None:
    clock = SlewedClock(7 * S, 500, 8 * S, 24 * S)
    steady = NodeSpec("cam0", PROFILES["perfect"], SimulatedClock(0, 10.0), LAN)
    rig = VirtualRig([NodeSpec("slewed", PROFILES["perfect"], clock, LAN), steady], seed=3)
    assert rig.run_until(rig.all_ready, limit_ns=8 * S)
    slewed = rig.nodes["slewed"]

    def changes() -> int:
        return slewed.events.count(ClockChanged(jumped=False))

    rig.run_for(8 * S - rig.now_true_ns)
    assert changes() == 0
    rig.run_for(3 * S)
    assert changes() == 1
    rig.run_for(24 * S - rig.now_true_ns)
    assert changes() == 1
    rig.run_for(3 * S)
    assert changes() == 2
    local_ns = clock.local_from_true(rig.now_true_ns)
    assert "has just changed: an NTP daemon" in slewed.client.report(local_ns).message
    assert ClockChanged(jumped=False) not in rig.nodes["cam0"].events
    assert abs(checked_error_ns(slewed.client.time_map, clock, rig.now_true_ns)) < 20_000
