"""Bursts whose frames are told as they come, in virtual time: of any length, ended early, cut off."""

from dataclasses import replace

from benchmarks.simulated.virtual_rig import NodeSpec
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from tests.unit.sync.rig.rigs import LAN, S, ready_rig
from tests.unit.sync.rig.test_streamed_bursts import ended


def test_a_time_lapse_is_aligned_between_its_instants() -> None:
    profile = replace(PROFILES["phone-a"], drop_fraction=0.0, outlier_fraction=0.0)
    rig = ready_rig([NodeSpec("cam0", profile, SimulatedClock(S), LAN)], seed=4)
    node = rig.nodes["cam0"]
    burst = rig.trigger(frames=4, spacing=450, streamed=True)
    before = node.client.aligner.corrections
    assert rig.run_until(lambda: ended(rig, burst.number), limit_ns=150 * S)
    assert [pick.instant for pick in node.bursts[burst.number].frames] == [0, 1, 2, 3]
    assert node.client.aligner.corrections > before
