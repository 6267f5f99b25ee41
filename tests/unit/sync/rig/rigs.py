"""Virtual rigs of cameras below one leader, as several tests put them together."""

from collections.abc import Sequence
from copy import deepcopy
from functools import cache
from typing import Any

from benchmarks.simulated.changing_clocks import WanderingClock
from benchmarks.simulated.links import Link
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wireless import GammaDelay
from capture_app.common.clock import NodeClock
from capture_app.sync.clock.time_map import TimeMap

MS, S = 1_000_000, 1_000_000_000
LAN = Link(GammaDelay(60_000, 90_000), GammaDelay(60_000, 90_000))


def ready_rig(specs: Sequence[NodeSpec], *, seed: int, limit_s: int = 30, **options: Any) -> VirtualRig:
    return deepcopy(run_until_ready(tuple(specs), seed, limit_s, tuple(options.items())))


@cache
def run_until_ready(
    specs: tuple[NodeSpec, ...], seed: int, limit_s: int, options: tuple[tuple[str, Any], ...]
) -> VirtualRig:
    """The same one for all tests, which copy it."""
    rig = VirtualRig(specs, seed=seed, **dict(options))
    assert rig.run_until(rig.all_ready, limit_ns=limit_s * S)
    return rig


def checked_error_ns(time_map: TimeMap | None, clock: NodeClock | WanderingClock, true_ns: int) -> int:
    """How far an estimate of the true time is off; its hard bound must hold."""
    assert time_map is not None
    local_ns = clock.local_from_true(true_ns)
    error_ns = time_map.leader_from_local(local_ns) - true_ns
    assert abs(error_ns) <= time_map.hard_bound_at(local_ns)
    return error_ns
