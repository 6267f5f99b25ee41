"""The whole chain, judged by pictures of the LED panel, at the paper's protocol and as the program comes.

Two phones take a picture of the same instant: one at the leader, one on the paper's WiFi. The LEDs that each
sees lit tell when its picture was taken (paper, section 6.1).
"""

import random
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import fmean, pstdev
from typing import TYPE_CHECKING

from benchmarks.paper.panel_trial import DEFAULT, EXPOSURE_NS, PAPERS, Trial, run_trial
from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.result import error_figures, new_figure, save
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
