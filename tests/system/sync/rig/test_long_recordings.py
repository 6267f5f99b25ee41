"""A recording of ten minutes: its cameras stay within 0.3 ms of each other, except while they are moved."""

from dataclasses import replace

from benchmarks.simulated.virtual_rig import NodeSpec
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.rig.events import PhaseMoved
from tests.unit.sync.rig.rigs import LAN, S, ready_rig

LASTS_S, FPS = 600, 30


def test_cameras_stay_in_phase_for_ten_minutes() -> None:
    """Three simulated phones and a simulated Pi, whose crystals are up to 20 ppm off."""
    profiles = ("phone-a", "phone-b", "phone-a", "pi")
    specs = [NodeSpec(f"cam{n}", PROFILES[of], SimulatedClock(n * S), LAN) for n, of in enumerate(profiles)]
    rig = ready_rig(specs, seed=3, limit_s=120)
    for node in rig.nodes.values():
        node.client.config = replace(node.client.config, moves_in_recordings=True)
    burst = rig.trigger(frames=LASTS_S * FPS, streamed=True)
    limit_ns = (LASTS_S + 20) * S
    assert rig.run_until(
        lambda: all(burst.number in of.bursts and of.bursts[burst.number].ended for of in rig.nodes.values()),
        limit_ns=limit_ns,
    )
    moved: set[int] = set()
    errors_ns: dict[int, list[int]] = {}
    for node in rig.nodes.values():
        for event in node.events:
            if isinstance(event, PhaseMoved):
                at_ns = node.spec.clock.true_from_local(event.local_ns)
                first = round((at_ns - burst.instants_ns[0]) / burst.step_ns)
                moved |= {*range(first - 3, first + 1)}
        for pick in node.bursts[burst.number].frames:
            error_ns = pick.frame.start_true_ns - burst.instants_ns[pick.instant]
            errors_ns.setdefault(pick.instant, []).append(error_ns)
    spreads_ns = {n: max(of) - min(of) for n, of in errors_ns.items() if len(of) == len(profiles)}
    assert len(spreads_ns) > 0.95 * LASTS_S * FPS, "phones drop one frame in a hundred"
    assert {n for n, spread_ns in spreads_ns.items() if spread_ns > 300_000} <= moved
    assert len(moved) < 0.05 * LASTS_S * FPS
