"""A rig never calls a camera ready by what was true before its leader was gone."""

from benchmarks.simulated.links import Link
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wireless import GammaDelay
from capture_app.common.clock import SimulatedClock
from capture_app.common.node_state import NodeState
from capture_app.plugins.cameras.sim.profiles import PROFILES

S = 1_000_000_000
CABLE = Link(GammaDelay(30_000, 45_000), GammaDelay(30_000, 45_000))


def test_a_stream_that_moved_while_there_was_no_clock_is_aligned_before_it_is_ready() -> None:
    rig = VirtualRig([NodeSpec("cam", PROFILES["phone-a"], SimulatedClock(0), CABLE, 60_000)], seed=4)
    assert rig.run_until(rig.all_ready, limit_ns=20 * S)
    node = rig.nodes["cam"]
    assert node.client.aligner.window.aligned
    rig.restart_leader()
    assert rig.run_until(lambda: node.client.state is NodeState.SYNCING, limit_ns=20 * S)
    node.sensor.inject(50_000_000, rig.now_true_ns)
    states = set()

    def has_left_syncing() -> bool:
        states.add(node.client.state)
        return node.client.state is not NodeState.SYNCING

    assert rig.run_until(has_left_syncing, limit_ns=20 * S)
    assert not node.client.aligner.window.aligned
    assert NodeState.READY not in states, "by what was true before"
    assert rig.run_until(rig.all_ready, limit_ns=20 * S)
    assert abs(node.client.instant_of(node.client.ring.newest_local_ns or 0)[2]) < 60_000
