"""Triggers sent to cameras that are not synchronized, by their known mechanisms, beside the whole chain."""

import random
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from capture_app.experiments.common.paper_values import TABLE_1, TABLE_2
from capture_app.experiments.common.plots import new_figure, save
from capture_app.experiments.common.result import Outcome, Result, Table, error_figures
from capture_app.experiments.common.workers import call_all
from capture_app.experiments.led_panel.trial import run_trial
from capture_app.experiments.naive.mechanisms import TRIGGERS

TRIALS = 1000
CHAIN_SHARE = 0.005
"""Share of the trials that the whole chain gets: it takes a second each, the others none."""
CHAIN_LEAST = 3
FIGURES = {"mean_abs": "mean", "max": "max", "std": "std"}
"""Ours and the paper's names."""
NOTES = (
    "Modelled from mechanisms that have published numbers, none of them the paper's table: input polling, "
    "Bluetooth connection intervals, WiFi power saving, the frame grid. What the paper's phones have beyond "
    "that, their camera apps added.",
    "Failed triggers (the paper: 2 of 20 wired, 1 of 20 by Bluetooth) have no such mechanism and are not "
    "modelled.",
    "Ours is the whole chain of `led-panel`, in fewer trials.",
)


def draw_sizes(seed: str, count: int) -> dict[str, list[float]]:
    """How far apart pictures are, in ms, by trigger."""
    sizes: dict[str, list[float]] = {}
    for name, trigger in TRIGGERS.items():
        rng = random.Random(f"{seed}/{name}")
        sizes[name] = [trigger.apart_ms(rng) for _ in range(count)]
    return sizes


def run(
    *, trials: int | None, seed: int, talk: Callable[[str], None], least_chain_trials: int = CHAIN_LEAST
) -> Outcome:
    """Run it: the modelled triggers, and our chain read off pictures of the LED panel."""
    count = TRIALS if trials is None else trials
    sizes_ms = draw_sizes(str(seed), count)
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
        baseline={f"{name}_ms": figures_of(sizes) for name, sizes in sizes_ms.items()},
        paper={
            f"{name}_ms": {ours: TABLE_1[f"{name}.{theirs}"] for ours, theirs in FIGURES.items()}
            | ({"failed_of_20": TABLE_1[f"{name}.failed"]} if name != "wifi" else {})
            for name in TRIGGERS
            if name != "usb"
        },
    )
    return Outcome(result, (_table(result),), NOTES, lambda folder: [_draw(sizes_ms, folder / "naive.png")])


def figures_of(sizes_ms: list[float]) -> dict[str, float]:
    """Mean, largest and deviation of distances in ms."""
    figures = error_figures(sizes_ms)
    return {key: figures[key] for key in FIGURES}


def _table(result: Result) -> Table:
    rows = []
    for name, trigger in TRIGGERS.items():
        paper = result.paper.get(f"{name}_ms")
        rows.append(
            (
                trigger.title,
                trigger.mechanisms,
                *(f"{result.baseline[f'{name}_ms'][key]:.0f} ms" for key in FIGURES),
                *(f"{paper[key]:.0f} ms" if paper else "-" for key in FIGURES),
                f"{paper['failed_of_20']:.0f} of 20" if paper and "failed_of_20" in paper else "-",
            )
        )
    ours = result.ours["total_us"]
    chain = tuple(f"{ours[key] / 1000:.3f} ms" for key in FIGURES)
    theirs = tuple(f"{TABLE_2[f'total.{key}'] / 1000:.3f} ms" for key in FIGURES.values())
    rows.append(("our chain, simulated", "clock and phase", *chain, *theirs, "-"))
    head = ("way", "mechanisms", "mean", "largest", "std", "paper: mean", "largest", "std", "failed")
    return Table(head, rows, "How far apart two cameras' pictures are")


def _draw(sizes_ms: Mapping[str, list[float]], path: Path) -> Path:
    figure = new_figure(figsize=(15, 4))
    for axes, (name, sizes) in zip(figure.subplots(1, len(sizes_ms)), sizes_ms.items(), strict=True):
        axes.hist(sizes, bins=30)
        if name != "usb":
            mean_ms = TABLE_1[f"{name}.mean"]
            axes.axvline(mean_ms, color="tab:red", linestyle="--", label="paper: mean")
            axes.legend(fontsize="small")
        axes.set(title=TRIGGERS[name].title, xlabel="distance, ms", ylabel="trials", xlim=(0, None))
    return save(figure, path)
