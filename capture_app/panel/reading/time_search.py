"""Searches a whole cycle of a panel for the times that a picture may have been taken at."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_app.panel.pattern import COUNT, Panel
from capture_app.panel.reading.lamp_light import LINES
from capture_app.panel.reading.light_model import LightModel, Shutter

Floats = NDArray[np.float64]

STEPS = 8
"""Times tried for each tick."""
_MIDDLE_LINE = slice(LINES // 2, LINES // 2 + 1)
_GROUP_STEPS = 16
"""Times tried for each lamp of a group at most: they are further apart for those that are lit longer."""
SHORTEST_NS, LONGEST_NS, LONGEST_ROW_NS = 50e3, 24e6, 36e3
"""Exposures and row times that a camera may have that does not tell them."""
CANDIDATES, FEW_CANDIDATES = 12, 4
"""Of a shutter that is known, and of each that may be."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A time, in ns of the panel, and the shutter, that may be right."""

    middle_ns: float
    shutter: Shutter
    score: float


def possible_shutters(panel: Panel, exposure_ns: float | None, row_time_ns: float | None) -> list[Shutter]:
    """The shutter, or those to try where exposure or row time are not known."""
    turn_ns = COUNT * panel.tick_ns
    if exposure_ns is not None:
        exposures = [float(exposure_ns)]
    else:
        exposures = np.geomspace(SHORTEST_NS, min(turn_ns, LONGEST_NS), 16).tolist()
        # Longer ones than a turn of all columns differ by what they are longer than whole turns.
        exposures += np.arange(turn_ns * 1.2, LONGEST_NS, turn_ns / 5).tolist()
    shutters = []
    for exposure in exposures:
        row_times = np.linspace(0, LONGEST_ROW_NS, 7 if exposure > turn_ns else 11)
        rows = row_times.tolist() if row_time_ns is None else [float(row_time_ns)]
        shutters += [Shutter(exposure, row) for row in rows]
    return shutters


def search(model: LightModel, shutters: "list[Shutter]") -> list[Candidate]:
    """The likeliest times of the panel's cycle with any of the shutters, best first, a tick or more apart."""
    panel = model.panel
    step_ns = panel.tick_ns / STEPS
    times = np.arange(round(panel.cycle_ticks * STEPS))
    off, on = model.rough_fit()
    groups = [
        _Group(model, int(number), np.asarray(times * step_ns, float)) for number in np.unique(model.group)
    ]
    found: list[Candidate] = []
    for shutter in shutters:
        score = np.zeros(len(times))
        for group in groups:
            score += group.scores(shutter, off, on)
        for _ in range(CANDIDATES if len(shutters) == 1 else FEW_CANDIDATES):
            best = int(np.argmax(score))
            found.append(Candidate(best * step_ns, shutter, float(score[best])))
            score[np.arange(best - STEPS, best + STEPS + 1) % len(score)] = -np.inf
    found.sort(key=lambda one: -one.score)
    return found


class _Group:
    """Lamps that are lit by turns, and how well they fit at each of the times (ns) that are searched."""

    def __init__(self, model: LightModel, number: int, times_ns: Floats) -> None:
        self._model = model
        self._of = model.group == number
        period_ns, lit_ns = float(model.period[self._of][0]), float(model.lit[self._of][0])
        bins = COUNT * min(round(lit_ns / model.panel.tick_ns * STEPS), _GROUP_STEPS)
        self._times_ns = (np.arange(bins) + 0.5) * period_ns / bins
        self._bin = (times_ns / period_ns * bins).astype(int) % bins

    def scores(self, shutter: Shutter, off: float, on: float) -> Floats:
        """Log-likelihoods of the times, each the best of its own and its neighbours' of these lamps."""
        model, of = self._model, self._of
        shares = model.shares(self._times_ns, shutter, of, lines=_MIDDLE_LINE)
        variance = model.variance(shares, on, of)
        misfit = model.seen.light[of] - off - on * shares
        misfit = np.where(model.seen.saturated[of] & (misfit < 0), 0.0, misfit)
        score = -(3 * np.log1p(misfit**2 / variance / 5) + 0.5 * np.log(variance)).sum(axis=1)
        # Time is coarse here: what a neighbour can be, this may be.
        score = np.maximum(score, np.maximum(np.roll(score, 1), np.roll(score, -1)))
        return np.asarray(score[self._bin])
