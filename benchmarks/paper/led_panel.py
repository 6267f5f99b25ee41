"""The whole chain, judged by images of the LED panel, at the paper's protocol and by default.

Two phones take an image of the same instant, one at the leader, one on the paper's WiFi. The lit LEDs in each
image give its time (paper, section 6.1).
"""

import random
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.paper.five_phones import PAPERS_TOLERANCE_NS
from benchmarks.paper.panel_trial import DEFAULT, EXPOSURE_NS, PAPERS, Trial, run_trial
from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.result import error_figures, new_figure, save
from benchmarks.paper.trials import call_all, share_of
from benchmarks.paper.values import FIGURE_5, TABLE_2
from capture_app.companions.panel.panel_photograph import Image
from capture_app.console.terminal import talk
from capture_app.sync.rig.client import PHASE_TOLERANCE_NS


def draw_panel(pictures: tuple[Image, Image], path: Path) -> Path:
    """Draw the leader phone's and the client phone's views of the panel at one instant (BGR)."""
    figure = new_figure(figsize=(12, 4.7))
    for axes, picture, title in zip(figure.subplots(1, 2), pictures, ("leader", "client"), strict=True):
        axes.imshow(picture[..., ::-1])
        axes.set_title(title)
        axes.set_axis_off()
    return save(figure, path)


TRIALS = 239
TAU_US, REPEATS_MS = 200.0, 20.0
"""Parameters of the finer of the two panels; the other one, of 10 ms, excludes whole periods."""
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
    setups = [
        f"{PAPERS.messages} messages, phases undone and aligned to {PAPERS_TOLERANCE_NS / 1000:.0f} us, "
        f"clocks {PAPERS.skew_ppm:g} ppm apart (one sigma)",
        f"phases to {PHASE_TOLERANCE_NS / 1000:.0f} us, unknown phones, clocks "
        f"{DEFAULT.skew_ppm:g} ppm apart",
    ]
    tables = [
        Measured(_figures(trials), count, setup) for trials, setup in zip((papers, ours), setups, strict=True)
    ]
    return [
        Reproduction(
            of=TABLE_2,
            protocol=tables[0],
            default=tables[1],
            simulated=SIMULATED,
            notes=(
                "The total is read from the pictures, its parts from the truth; the paper takes the phase "
                "from timestamps.",
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
            simulated="As in Table II.",
            given=("tau", "exposure", "repeats"),
            draw=partial(draw_panel, first.pictures),
            suffix=".jpg",
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
