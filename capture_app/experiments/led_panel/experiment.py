"""The whole chain, judged by pictures of the LED panel, at the paper's protocol and as the program comes.

Two phones take a picture of the same instant: one at the leader, one on the paper's WiFi. The LEDs that each
sees lit tell when its picture was taken (paper, section 6.1).
"""

import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from statistics import pstdev
from typing import Any

from capture_app.experiments.common.paper_values import TABLE_2
from capture_app.experiments.common.result import Outcome, Result, Table, error_figures
from capture_app.experiments.common.workers import call_all
from capture_app.experiments.led_panel.plots import draw_led_panel
from capture_app.experiments.led_panel.trial import DEFAULT, PAPERS, Trial, run_trial

TRIALS = 239
SCATTERS_NS = (10_000, 20_000)
SCATTER_SHARE = 0.25
"""Share of the trials that phones whose injected frames scatter get."""
FAR_APART_US = TABLE_2["phase.max"]
"""The paper's largest error of the phase."""

PAPER = {
    f"{name}_us": {
        "mean_abs": TABLE_2[f"{name}.mean"],
        "max": TABLE_2[f"{name}.max"],
        "std": TABLE_2[f"{name}.std"],
    }
    for name in ("total", "phase")
}
NOTES = (
    "At the paper's protocol: 300 messages and no more on a link as at first, phases undone by a random long "
    "exposure, aligned to 20 us, and a picture asked for at once, which is taken half a second later. Clocks "
    "differ by 0.3 ppm (one sigma), as the paper's were stable. By default: 100 us, 15 ppm, phones of a "
    "model that nobody has seen, and messages that go on.",
    "total: decoded from the pictures; reading: what the pictures say minus the truth.",
    "oracle: an estimator that knows the laws of both ways and the rates of the clocks, on the same 300 "
    "messages: nobody can know the offset better on average. Who is not told how unequal the least delays of "
    "the two ways are, as no message tells it, is off by 19 us for that beside.",
    "scatter: injected frames move the phase by their whole rows, and by a normal error of that size.",
)


def run(*, trials: int | None, seed: int, talk: Callable[[str], None]) -> Outcome:
    """Run it; simulated throughout: clocks, link, sensors, panel. Nothing is kept between trials."""
    count = TRIALS if trials is None else trials
    few = max(1, round(SCATTER_SHARE * count))
    cases = {
        "": (PAPERS, count),
        "by_default": (DEFAULT, count),
        **{f"scatter_{ns // 1000}_us": (replace(PAPERS, scatter_ns=ns), few) for ns in SCATTERS_NS},
    }
    calls = [
        partial(run_trial, random.Random(f"{seed}/{n}"), protocol, keep=n == 0)
        for protocol, each in cases.values()
        for n in range(each)
    ]
    talk(f"{len(calls)} trials ...")
    done = iter(call_all(calls))
    trials_of = {name: [next(done) for _ in range(each)] for name, (_, each) in cases.items()}
    papers = trials_of.pop("")
    pictures = papers[0].pictures
    assert pictures is not None, "the first trial keeps them"
    result = Result(
        name="led-panel",
        kind="simulated",
        seed=seed,
        trials=count,
        ours=figures_of(papers) | {name: figures_of(some) for name, some in trials_of.items()},
        baseline={
            "oracle_clock_us": error_figures([trial.oracle_us for trial in papers]),
            "minimum_filter_clock_us": error_figures([trial.minimum_filter_us for trial in papers]),
        },
        paper=PAPER,
    )
    return Outcome(
        result,
        _tables(result),
        NOTES,
        lambda folder: draw_led_panel(papers, pictures, PAPER, folder),
    )


def figures_of(done: Sequence[Trial]) -> dict[str, Any]:
    """Errors in us by name, and what it took."""
    count, moves = len(done), [each for trial in done for each in trial.corrections]
    return {
        "total_us": error_figures([t.decoded_us for t in done]),
        "true_total_us": error_figures([t.true_us for t in done]),
        "clock_us": error_figures([t.clock_us for t in done]),
        "phase_us": error_figures([t.phase_us for t in done]),
        "reading_us": error_figures([t.decoded_us - t.true_us for t in done]),
        "phase_over_21_us_share": sum(abs(t.phase_us) > FAR_APART_US for t in done) / count,
        "ready_s": sum(t.ready_s for t in done) / count,
        "injections_mean": sum(moves) / len(moves),
        "injections_std": pstdev(moves),
        "injections_max": max(moves),
        "hard_bound_held_share": sum(t.bounded for t in done) / count,
        "coverage_95": sum(t.within_95 for t in done) / count,
    }


def _tables(result: Result) -> tuple[Table, ...]:
    ours, default, baseline = result.ours, result.ours["by_default"], result.baseline
    rows = [
        _row(name.removesuffix("_us").replace("_", " "), ours[name], result.paper.get(name))
        for name in ("total_us", "true_total_us", "clock_us", "phase_us", "reading_us")
    ]
    rows.append(_row("clock by the oracle", baseline["oracle_clock_us"], None))
    rows.append(_row("clock by the minimum filter", baseline["minimum_filter_clock_us"], None))
    for name in ("total_us", "clock_us", "phase_us"):
        rows.append(_row(f"{name.removesuffix('_us')} by default", default[name], None))
    for ns in SCATTERS_NS:
        some = ours[f"scatter_{ns // 1000}_us"]
        rows.append(_row(f"phase, scatter of {ns // 1000} us", some["phase_us"], None))
    scatters = [f"scatter_{ns // 1000}_us" for ns in SCATTERS_NS]
    took: list[tuple[str, ...]] = [
        (
            name.replace("_", " ") or "the paper's protocol",
            f"{figures['injections_mean']:.2f}",
            f"{figures['injections_std']:.2f}",
            f"{figures['injections_max']}",
            f"{figures['ready_s']:.2f}",
            f"{figures['hard_bound_held_share']:.1%}",
            f"{figures['coverage_95']:.1%}",
        )
        for name, figures in (
            ("", ours),
            *((name, ours[name]) for name in ("by_default", *scatters)),
        )
    ]
    head = ("error, us", "mean abs", "largest", "std", "bias", "paper: mean abs", "largest", "std")
    took_head = ("", "injected frames a phone", "std", "most", "ready, s", "hard bound held", "95 % held")
    title = f"{result.trials} pictures of two phones at the paper's protocol"
    return Table(head, rows, title), Table(took_head, took, "What it took (paper: 5.5 frames, std 0.97)")


def _row(name: str, ours: dict[str, float], paper: dict[str, float] | None) -> tuple[str, ...]:
    return (
        name,
        *(f"{ours[key]:.1f}" for key in ("mean_abs", "max", "std", "bias")),
        *(f"{paper[key]:g}" if paper else "-" for key in ("mean_abs", "max", "std")),
    )
