"""What a rig says before a recording about its cameras' phases, and what becomes of them in virtual time."""

import re

import pytest

from benchmarks.simulated import virtual_rig
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.node.leader.readiness import drift_apart
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.plugins.cameras.sim.sensor import Sensor
from tests.unit.sync.rig.rigs import LAN, S

LASTS_S = 120
NS_OF = {"µs": 1e3, "ms": 1e6}


@pytest.mark.parametrize("ppm", [(-20.0, 0.0, 20.0), (0.0, 3.0, 6.0)])
def test_injecting_cameras_drift_apart_as_far_as_is_said_beforehand(
    monkeypatch: pytest.MonkeyPatch, ppm: tuple[float, ...]
) -> None:
    crystals = iter(ppm)
    monkeypatch.setattr(
        virtual_rig, "Sensor", lambda profile, rng: Sensor(profile, rng, period_error_ppm=next(crystals))
    )
    names = [f"cam{number}" for number in range(len(ppm))]
    specs = [NodeSpec(name, PROFILES["phone-a"], SimulatedClock(S), LAN) for name in names]
    rig = VirtualRig(specs, seed=3)
    assert rig.run_until(rig.all_ready, limit_ns=60 * S)
    grid = rig.leader.grid
    assert grid is not None
    sentence = drift_apart(grid, rig.leader.roster.cameras(), rig.leader_ns, LASTS_S * S)
    said = re.match(r"the cameras will drift apart by ([\d.]+) (µs|ms) within 120.0 s", sentence)
    assert said is not None, sentence
    burst = rig.trigger(frames=LASTS_S * S // grid.period_ns, streamed=True, video=True)
    rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[-1] + S, limit_ns=(LASTS_S + 5) * S)
    last = [rig.nodes[name].bursts[burst.number].frames[-1] for name in names]
    assert {pick.instant for pick in last} == {burst.frames - 1}
    starts_ns = [pick.frame.start_true_ns for pick in last]
    said_ns = float(said[1]) * NS_OF[said[2]]
    assert said_ns / 2 <= max(starts_ns) - min(starts_ns) <= 2 * said_ns
