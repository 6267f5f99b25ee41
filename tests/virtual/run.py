"""Run seeds: their plans, what broke, and what it cost."""

import gc
import os
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

from tests.virtual.invariants import broken
from tests.virtual.plan import Plan, draw
from tests.virtual.planted import PLANTED
from tests.virtual.rig import VirtualRig
from tests.virtual.world import StuckError, World

_cpu_s = time.process_time


@dataclass(frozen=True, slots=True)
class Result:
    """What a run showed."""

    seed: int
    failures: tuple[str, ...]
    digest: str
    virtual_s: float
    cpu_s: float
    bursts: int
    whole: int
    images: int
    inside: int
    trace: tuple[tuple[int, str, str], ...]

    def __str__(self) -> str:
        line = (
            f"seed {self.seed}: {self.virtual_s:.0f} virtual s, {self.cpu_s:.1f} CPU-s, {self.bursts} takes,"
            f" {self.whole} saved, {self.inside} of {self.images} times within their bars, {self.digest}"
        )
        return line + "".join(f"\n    BROKEN {failure}" for failure in self.failures)


def run(plan: Plan, planted: Callable[[World], AbstractContextManager[Any]] | None = None) -> Result:
    """Run a plan in a world of its own; `planted` puts a fault into the product."""
    began_s = _cpu_s()
    world = World(plan.seed)
    rig = VirtualRig(world, plan)
    open_before = os.environ.get("SIMULSHOT_OPEN")
    os.environ["SIMULSHOT_OPEN"] = "1"
    failures: list[str] = []
    gc.freeze()  # or collecting what a test run has on its heap counts as a step of the rig's
    try:
        with world.entered(), rig.observed(), planted(world) if planted else nullcontext():
            try:
                world.run(rig.run())
            except StuckError as error:
                world.fail(f"stuck: {error}")
        failures = [*world.failures, *broken(rig)]
    finally:
        if open_before is None:
            del os.environ["SIMULSHOT_OPEN"]
        else:
            os.environ["SIMULSHOT_OPEN"] = open_before
        world.disks.remove()
        gc.collect()
        gc.unfreeze()
    return Result(
        plan.seed,
        tuple(failures),
        world.digest(),
        world.elapsed_s(),
        _cpu_s() - began_s,
        len(rig.evidence.takes),
        sum(take.result.endswith("saved") for take in rig.evidence.takes),
        rig.total,
        rig.inside,
        tuple(world.trace),
    )


def run_seed(seed: int, plant: str = "") -> Result:
    """Draw and run a seed, with the planted fault of that name if any."""
    return run(draw(seed), PLANTED.get(plant))
