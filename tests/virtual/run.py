"""Run seeds: their plans, what broke, and what it cost."""

import gc
import os
import time
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import count

from tests.virtual.evidence import TimeError
from tests.virtual.invariants import broken, misjudged
from tests.virtual.observing import observed
from tests.virtual.plan import Plan, draw
from tests.virtual.planted import FAULTS, Fault, fitting_seeds
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
    times: tuple[TimeError, ...]
    """Error of each image's time."""
    trace: tuple[tuple[int, str, str], ...]

    def __str__(self) -> str:
        inside = sum(of.error_ns <= of.uncertainty_ns for of in self.times)
        line = (
            f"seed {self.seed}: {self.virtual_s:.0f} virtual s, {self.cpu_s:.1f} CPU-s, {self.bursts} takes,"
            f" {self.whole} saved, {inside} of {len(self.times)} times within their 95 % uncertainties,"
            f" {self.digest}"
        )
        return line + "".join(f"\n    BROKEN {failure}" for failure in self.failures)


def run(plan: Plan, fault: Fault | None = None) -> Result:
    """Run a plan in a world of its own, with a fault in the product if one is given."""
    began_s = _cpu_s()
    world = World(plan.seed)
    rig = VirtualRig(world, plan)
    open_before = os.environ.get("SIMULSHOT_OPEN")
    os.environ["SIMULSHOT_OPEN"] = "1"
    failures: list[str] = []
    gc.freeze()  # or collecting what a test run has on its heap counts as a step of the rig's
    try:
        with nullcontext() if fault is None else fault.planted(), world.entered(), observed(rig):
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
        tuple(rig.times),
        tuple(world.trace),
    )


def run_seed(seed: int, plant: str = "") -> Result:
    """Draw and run a seed, with the planted fault of that name if any."""
    return run(draw(seed), FAULTS[plant] if plant else None)


def judged_together(results: Iterable[Result]) -> Iterator[Result]:
    """Yield results as they come; one whose times show what no seed alone can fails with that."""
    times: list[tuple[int, TimeError]] = []
    found: set[str] = set()
    for result in results:
        times += [(result.seed, of) for of in result.times]
        new = [words for words in misjudged(times) if words.split(":")[0][:40] not in found]
        found |= {words.split(":")[0][:40] for words in new}
        yield replace(result, failures=(*result.failures, *new)) if new else result


@dataclass(frozen=True, slots=True)
class Hunt:
    """How a planted fault was searched."""

    name: str
    seed: int | None
    """The first fitting seed that finds it; None if none does."""
    tried: int
    """Number of fitting seeds until then."""
    message: str
    """What the seed says."""
    cpu_s: float

    def __str__(self) -> str:
        found = "NOT FOUND" if self.seed is None else f"seed {self.seed}"
        return f"{self.name:16} {found:12} {self.tried:3} tried {self.cpu_s:4.0f} CPU-s  {self.message}"


def hunt(name: str, first: int = 0) -> Hunt:
    """Search the first fitting seed that finds a planted fault; one that fails without it does not count."""
    fault, tried, cpu_s = FAULTS[name], 0, 0.0
    for result in judged_together(run_seed(seed, name) for seed in fitting_seeds(fault, count(first))):
        tried, cpu_s = tried + 1, cpu_s + result.cpu_s
        if result.failures:
            sound = run_seed(result.seed)
            cpu_s += sound.cpu_s
            if new := [words for words in result.failures if words not in sound.failures]:
                return Hunt(name, result.seed, tried, new[0], cpu_s)
    return Hunt(name, None, tried, fault.what, cpu_s)
