"""The whole chain, judged by pictures of the LED panel, at the paper's protocol and as the program comes.

Two phones take a picture of the same instant: one at the leader, one on the paper's WiFi. The LEDs that each
sees lit tell when its picture was taken (paper, section 6.1).
"""

import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean, pstdev
from typing import TYPE_CHECKING, Any

from benchmarks.paper.panel_trial import DEFAULT, EXPOSURE_NS, PAPERS, Trial, run_trial
from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.result import Outcome, Result, Table, error_figures, new_figure, save
from benchmarks.paper.trials import call_all, share_of
from benchmarks.paper.values import FIGURE_5, FIGURE_6, TABLE_2
from capture_app.console.terminal import talk
from capture_app.simulation.rendering.panel_photograph import Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes


PARTS = {"phase": "phase", "clock": "clock", "total": "phase and clock"}
BINS = 41


def draw_histograms(trials: Mapping[str, Sequence[Trial]], path: Path) -> Path:
    """Draw the errors of phase, clock and both, a row for each set-up, with the paper's figures dashed."""
    figure = new_figure(figsize=(12, 3.2 * len(trials)))
    rows = figure.subplots(len(trials), len(PARTS), squeeze=False, sharex="col")
    errors_us = {
        setup: {
            "phase": [trial.phase_us for trial in done],
            "clock": [trial.clock_us for trial in done],
            "total": [trial.decoded_us for trial in done],
        }
        for setup, done in trials.items()
    }
    for column, (part, name) in enumerate(PARTS.items()):
        # The same bins in all rows, so that heights can be compared.
        all_us = [us for errors in errors_us.values() for us in errors[part]]
        reach = max(TABLE_2[f"{part}.max"], *(abs(us) for us in all_us))
        for row, setup in enumerate(trials):
            axes = rows[row][column]
            axes.hist(errors_us[setup][part], bins=BINS, range=(-reach, reach), color="tab:blue")
            axes.set_title(f"{name}, {setup}", fontsize="medium")
            _mark(axes, part)
    for axes in rows[-1]:
        axes.set_xlabel("client minus leader, µs")
    for axes_of in rows:
        axes_of[0].set_ylabel("trials")
    lines, labels = rows[0][0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", ncols=len(labels))
    return save(figure, path)


def _mark(axes: "Axes", part: str) -> None:
    """Mark the paper's mean and largest errors, to both sides."""
    for name, style in (("mean", "--"), ("max", ":")):
        at = TABLE_2[f"{part}.{name}"]
        label = "the paper's mean" if name == "mean" else "the paper's largest"
        axes.axvline(at, color="tab:red", linestyle=style, lw=1, label=label)
        axes.axvline(-at, color="tab:red", linestyle=style, lw=1)


def draw_panel(pictures: tuple[Image, Image], path: Path) -> Path:
    """Draw what the leader's phone and the client's phone see of the panel at one instant (BGR)."""
    figure = new_figure(figsize=(12, 4.7))
    for axes, picture, title in zip(figure.subplots(1, 2), pictures, ("leader", "client"), strict=True):
        axes.imshow(picture[..., ::-1])
        axes.set_title(title)
        axes.set_axis_off()
    return save(figure, path)


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


def run(*, trials: int | None, seed: int) -> Outcome:
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
        lambda folder: [
            draw_histograms({"at the paper's protocol": papers}, folder / "led-panel.png"),
            draw_panel(pictures, folder / "led-panel-pictures.png"),
        ],
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


TRIALS = 239
TAU_US, REPEATS_MS = 200.0, 20.0
"""Of the finer one of the two panels; the other one, of 10 ms, excludes whole periods."""
SIMULATED = (
    "Phones, clocks, the paper's link, the panel and its pictures. One phone is at the leader, one on the "
    "link."
)


def paper_part(*, share: float, seed: int) -> Sequence[Reproduction]:
    """Measure both phones as often as the paper did, at its protocol and by default."""
    count = share_of(TRIALS, share, least=1)
    calls = [
        partial(run_trial, random.Random(f"{seed}/{n}"), protocol, keep=n == 0)
        for protocol in (PAPERS, DEFAULT)
        for n in range(count)
    ]
    done = call_all(calls)
    talk(f"{count} trials of two phones before the panel, twice")
    papers, ours = done[:count], done[count:]
    first = papers[0]
    assert first.pictures is not None, "the first trial keeps them"
    oracle, least = (
        error_figures(errors)
        for errors in ([t.oracle_us for t in papers], [t.minimum_filter_us for t in papers])
    )
    moves, seconds = [each for t in papers for each in t.corrections], [t.ready_s for t in papers]
    setups = [
        f"{PAPERS.messages} messages, phases undone and aligned to {PAPERS.tolerance_ns / 1000:.0f} us, "
        f"clocks {PAPERS.skew_ppm:g} ppm apart (one sigma)",
        f"phases to {DEFAULT.tolerance_ns / 1000:.0f} us, phones that nobody has seen, clocks "
        f"{DEFAULT.skew_ppm:g} ppm apart",
    ]
    tables = [
        Measured(_figures(trials), count, setup) for trials, setup in zip((papers, ours), setups, strict=True)
    ]
    histograms = {"at the paper's protocol": papers, "by default": ours}
    return [
        Reproduction(
            of=TABLE_2,
            protocol=tables[0],
            default=tables[1],
            simulated=SIMULATED,
            notes=(
                "Total is read off the pictures. Its parts are true ones, as the simulation knows both: the "
                "paper has the phase from its stamps and the clock's part as the difference.",
                f"A second panel with tau = 10 ms, as in the paper, tells whole periods of the first apart: "
                f"of {count} trials {sum(map(_is_astray, papers))} at the protocol and "
                f"{sum(map(_is_astray, ours))} by default were read a period off.",
                "Pictures are asked for as soon as both phones are ready, and taken half a second later.",
                f"At the protocol it took {fmean(moves):.1f} injected frames a phone (standard deviation "
                f"{pstdev(moves):.2f}, {max(moves)} at most) and {fmean(seconds):.1f} s, with the clock's "
                "messages.",
                f"An oracle that knows the link's laws, floors included, is off by {oracle['mean_abs']:.1f} "
                f"us with the same messages ({oracle['max']:.0f} at most), the minimum filter by "
                f"{least['mean_abs']:.1f} ({least['max']:.0f}).",
            ),
        ),
        Reproduction(
            of=FIGURE_5,
            protocol=Measured(
                {
                    "tau": TAU_US,
                    "exposure": EXPOSURE_NS / 1000,
                    "repeats": REPEATS_MS,
                    "apart": abs(first.decoded_us),
                },
                1,
                setups[0],
            ),
            default=None,
            simulated=SIMULATED,
            given=("tau", "exposure", "repeats"),
            draw=partial(draw_panel, first.pictures),
            suffix=".jpg",
        ),
        Reproduction(
            of=FIGURE_6,
            protocol=tables[0].only(FIGURE_6.names),
            default=tables[1].only(FIGURE_6.names),
            simulated=SIMULATED,
            draw=partial(draw_histograms, histograms),
        ),
    ]


def _is_astray(trial: Trial) -> bool:
    """Whether a whole period of the panel was lost, or half of one."""
    return abs(trial.decoded_us - trial.true_us) > REPEATS_MS * 1000 / 2


def _figures(trials: Sequence[Trial]) -> dict[str, float]:
    errors = {
        "total": error_figures([trial.decoded_us for trial in trials]),
        "phase": error_figures([trial.phase_us for trial in trials]),
        "clock": error_figures([trial.clock_us for trial in trials]),
    }
    names = {"mean": "mean_abs", "max": "max", "std": "std"}
    return {f"{part}.{name}": figures[key] for part, figures in errors.items() for name, key in names.items()}
