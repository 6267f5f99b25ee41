"""The paper's Table II and figures 5 and 6: two phones before the panel, right after their alignment."""

import random
from collections.abc import Callable, Sequence
from functools import partial

from capture_app.experiments.common.paper_values import FIGURE_5, FIGURE_6, TABLE_2
from capture_app.experiments.common.reproduction import Measured, Reproduction, share_of
from capture_app.experiments.common.result import error_figures
from capture_app.experiments.common.workers import call_all
from capture_app.experiments.led_panel.experiment import (
    AT_ITS_BEST,
    EXPOSURE_NS,
    PanelProtocol,
    Trial,
    run_trial,
)
from capture_app.experiments.led_panel.paper_plots import draw_histograms, draw_panel
from capture_app.node.camera.camera_node import DEFAULT_TOLERANCE_NS

TRIALS = 239
PAPERS = PanelProtocol(20_000)
DEFAULT = PanelProtocol(DEFAULT_TOLERANCE_NS)
TAU_US, REPEATS_MS = 200.0, 20.0
"""Of the finer one of the two panels; the other one, of 10 ms, excludes whole periods."""
SIMULATED = (
    "Phones of a model that nobody has seen, clocks (15 ppm, one sigma), the paper's link, the panel and its "
    "pictures. One phone is at the leader, one on the link; everything starts anew in each trial."
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
    setups = [
        f"phases to {protocol.tolerance_ns / 1000:.0f} us, the picture as soon as both phones are ready"
        for protocol in (PAPERS, DEFAULT)
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
                f"`capture-app experiment led-panel` has what the engine does where there is time: phases to "
                f"{AT_ITS_BEST.tolerance_ns / 1000:.0f} us, {AT_ITS_BEST.settle_ns / 1e9:.0f} s of waiting, "
                f"and {AT_ITS_BEST.max_delay_ns / 1e9:.1f} s of freedom for the trigger.",
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
