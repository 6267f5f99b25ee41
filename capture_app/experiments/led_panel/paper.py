"""The paper's Table II and figures 5 and 6: two phones before the panel, right after their alignment."""

import random
from collections.abc import Callable, Sequence
from functools import partial
from statistics import fmean, pstdev

from capture_app.experiments.common.paper_values import FIGURE_5, FIGURE_6, TABLE_2
from capture_app.experiments.common.reproduction import Measured, Reproduction, share_of
from capture_app.experiments.common.result import error_figures
from capture_app.experiments.common.workers import call_all
from capture_app.experiments.led_panel.paper_plots import draw_histograms, draw_panel
from capture_app.experiments.led_panel.trial import DEFAULT, EXPOSURE_NS, PAPERS, Trial, run_trial

TRIALS = 239
TAU_US, REPEATS_MS = 200.0, 20.0
"""Of the finer one of the two panels; the other one, of 10 ms, excludes whole periods."""
SIMULATED = (
    "Phones, clocks, the paper's link, the panel and its pictures. One phone is at the leader, one on the "
    "link."
)


def paper_part(*, share: float, seed: int, talk: Callable[[str], None]) -> Sequence[Reproduction]:
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
            seed=seed,
            protocol=tables[0],
            default=tables[1],
            simulated=SIMULATED,
            notes=(
                "Total is read off the pictures. Its parts are true ones, as the simulation knows both: the "
                "paper has the phase from its stamps and the clock's part as the difference.",
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
            seed=seed,
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
        ),
        Reproduction(
            of=FIGURE_6,
            seed=seed,
            protocol=Measured(_only(tables[0], FIGURE_6.names), count, setups[0]),
            default=Measured(_only(tables[1], FIGURE_6.names), count, setups[1]),
            simulated=SIMULATED,
            draw=partial(draw_histograms, histograms),
        ),
    ]


def _figures(trials: Sequence[Trial]) -> dict[str, float]:
    errors = {
        "total": error_figures([trial.decoded_us for trial in trials]),
        "phase": error_figures([trial.phase_us for trial in trials]),
        "clock": error_figures([trial.clock_us for trial in trials]),
    }
    names = {"mean": "mean_abs", "max": "max", "std": "std"}
    return {f"{part}.{name}": figures[key] for part, figures in errors.items() for name, key in names.items()}


def _only(measured: Measured, names: Sequence[str]) -> dict[str, float]:
    return {name: measured.values[name] for name in names}
