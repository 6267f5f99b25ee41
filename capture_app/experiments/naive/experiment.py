"""Triggers sent to cameras that are not synchronized: their pictures' distance, beside the whole chain.

The triggers are no measurement of ours: their errors are drawn from a law that has the paper's figures.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from capture_app.experiments.common.result import Outcome, Result, Table, error_figures
from capture_app.experiments.common.workers import call_all
from capture_app.experiments.led_panel.experiment import EXPOSURE_NS, run_trial
from capture_app.experiments.led_panel.plots import draw_naive
from capture_app.simulation.devices.profiles import PROFILES
from capture_app.simulation.rendering.led_panel import CYCLE_NS, read_time, render

TRIALS = 100
CHAIN_SHARE = 0.05
"""Share of the trials that the whole chain gets: it takes a second each, the others none."""
CHAIN_LEAST = 3


@dataclass(frozen=True, slots=True)
class TriggerErrors:
    """The paper's figures of one way of triggering: largest, mean and deviation of the size of the error."""

    largest_ms: float
    mean_ms: float
    std_ms: float

    def draw_ms(self, rng: random.Random) -> float:
        """How much later one camera is, in ms: from the Beta law of this largest, mean and deviation."""
        mean, variance = self.mean_ms / self.largest_ms, (self.std_ms / self.largest_ms) ** 2
        weight = mean * (1.0 - mean) / variance - 1.0
        return self.largest_ms * rng.betavariate(mean * weight, (1.0 - mean) * weight)


PAPERS = {
    "wired": TriggerErrors(180.0, 103.0, 50.0),
    "bluetooth": TriggerErrors(200.0, 69.0, 65.0),
    "wifi": TriggerErrors(677.0, 123.0, 84.0),
}


def run(
    *, trials: int | None, seed: int, talk: Callable[[str], None], least_chain_trials: int = CHAIN_LEAST
) -> Outcome:
    """Run it; both the modelled triggers and our chain are read off pictures of the LED panel."""
    count = TRIALS if trials is None else trials
    sizes_ms: dict[str, list[float]] = {}
    for name, law in PAPERS.items():
        talk(f"{name} triggers ...")
        rng = random.Random(f"{seed}/{name}")
        sizes_ms[name] = [_read_ms(law.draw_ms(rng), rng) for _ in range(count)]
    chain = max(least_chain_trials, round(CHAIN_SHARE * count))
    talk("our chain ...")
    done = call_all([partial(run_trial, random.Random(f"{seed}/{n}")) for n in range(chain)])
    chain_us = [trial.decoded_us for trial in done]
    result = Result(
        name="naive",
        kind="simulated",
        seed=seed,
        trials=count,
        ours={"total_us": error_figures(chain_us), "chain_trials": chain},
        baseline={f"{name}_ms": _figures(sizes) for name, sizes in sizes_ms.items()},
        paper={
            f"{name}_ms": {"mean_abs": law.mean_ms, "max": law.largest_ms, "std": law.std_ms}
            for name, law in PAPERS.items()
        },
    )
    return Outcome(
        result,
        (_table(result),),
        NOTES,
        lambda folder: [draw_naive(sizes_ms, chain_us, result.paper, folder)],
    )


NOTES = (
    "The triggers' errors are modelled: from Beta laws with the paper's largest error, mean and deviation.",
    "Ours is the whole chain of `led-panel`, in fewer trials; both are read off pictures of the panel.",
)


def _read_ms(error_ms: float, rng: random.Random) -> float:
    """What the panel's pictures say of two cameras that far apart."""
    profile, noise = PROFILES["phone-a"], np.random.default_rng(rng.getrandbits(32))
    first_ns = rng.randrange(int(CYCLE_NS))
    times_ns = []
    for start_ns in (first_ns, first_ns + round(error_ms * 1e6)):
        shape = {"exposure_ns": EXPOSURE_NS, "row_time_ns": profile.row_time_ns}
        times_ns.append(read_time(render(start_ns, rng=noise, **shape), **shape))
    return (times_ns[1] - times_ns[0]) % CYCLE_NS / 1e6


def _figures(sizes_ms: list[float]) -> dict[str, float]:
    figures = error_figures(sizes_ms)
    return {key: figures[key] for key in ("mean_abs", "max", "std")}


def _table(result: Result) -> Table:
    rows = [
        (
            f"{name} trigger, modelled",
            *(f"{result.baseline[f'{name}_ms'][key]:.0f} ms" for key in ("mean_abs", "max", "std")),
            *(f"{result.paper[f'{name}_ms'][key]:.0f} ms" for key in ("mean_abs", "max", "std")),
        )
        for name in PAPERS
    ]
    ours = result.ours["total_us"]
    chain = tuple(f"{ours[key] / 1000:.3f} ms" for key in ("mean_abs", "max", "std"))
    rows.append(("our chain, simulated", *chain, "0.032 ms", "0.121 ms", "0.025 ms"))
    head = ("way", "mean abs", "largest", "std", "paper: mean abs", "largest", "std")
    return Table(head, rows, "How far apart two cameras' pictures are")
