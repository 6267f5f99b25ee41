"""A grid that one camera's contradicting reports do not move, be it a liar or a webcam with a bad clock."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache

from msgspec import structs

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualNode, VirtualRig
from capture_app.common.camera_facts import PhaseControl
from capture_app.common.clock import SimulatedClock
from capture_app.common.node_state import NodeState
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.datagrams import Heartbeat, Hello, Report
from tests.unit.sync.rig.rigs import LAN, MS, S

HONEST = ("cam1", "cam2")


class RigWithALiar(VirtualRig):
    """A rig in which the reports of the node `liar` are changed on their way to the leader."""

    lie: Callable[[Report], Report] | None = None
    control = PhaseControl.NONE

    def _to_leader(self, data: bytes, node: VirtualNode) -> None:
        if node.spec.name == "liar":
            message = decode(data)
            if isinstance(message, Hello):
                camera = structs.replace(message.camera, phase_control=self.control)
                data = encode(structs.replace(message, camera=camera))
            if isinstance(message, Heartbeat) and self.lie is not None:
                data = encode(Heartbeat(message.client, self.lie(message.report)))
        super()._to_leader(data, node)

    def looks(self, count: int, every_ns: int = S) -> list[bool]:
        """Whether the honest cameras are ready, at each of so many looks."""
        found = []
        for _ in range(count):
            self.run_for(every_ns)
            members = self.leader.roster.members
            found.append(all(members[name].report.state is NodeState.READY for name in HONEST))
        return found


def rig_with_a_liar(control: PhaseControl) -> RigWithALiar:
    profile = replace(PROFILES["phone-a"], row_time_ns=10_000, frame_length_rows=3333)
    specs = [
        NodeSpec(name, profile, SimulatedClock(7 * number * S, 5.0 * number), LAN, tolerance_ns=MS)
        for number, name in enumerate((*HONEST, "liar"))
    ]
    rig = RigWithALiar(specs, seed=3)
    rig.control = control
    return rig


def ready_rig_with_a_liar(control: PhaseControl) -> RigWithALiar:
    return deepcopy(run_until_ready(control))


@cache
def run_until_ready(control: PhaseControl) -> RigWithALiar:
    """The same one for all tests, which copy it."""
    rig = rig_with_a_liar(control)
    assert rig.run_until(rig.all_ready, limit_ns=60 * S)
    return rig


def test_a_camera_that_cannot_move_and_says_the_truth_has_the_grid_moved_to_it() -> None:
    rig = ready_rig_with_a_liar(PhaseControl.NONE)
    assert rig.leader.grid is not None
    at_ns = rig.leader.roster.members["liar"].report.frame_leader_ns
    assert at_ns is not None
    assert abs(rig.leader.grid.phase_error(at_ns)) <= 2 * MS
