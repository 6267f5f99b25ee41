"""How likely each time is that a picture of a panel may have been taken at."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture_app.panel.reading.finder import PanelNotFoundError
from capture_app.panel.reading.light_model import TONES, LightModel, Shutter
from capture_app.panel.reading.time_search import Candidate

Floats = NDArray[np.float64]

TEMPER = 0.55
"""Misfits of neighbouring lamps have causes in common: so much of their log-likelihood counts."""
SHARE = 0.95
"""Of the cases in which the time is within its error bar."""
_RIVAL, _RIVAL_TEMPER = 0.005, 0.6
"""A picture is refused where a time elsewhere has this chance; other lamps tell it, so that more counts."""
_OPEN = 0.05
"""A neighbourhood at whose ends times have this chance, against its best, does not bound the time."""
_TIMES = 301
_WORTH = 25.0
"""Candidates worse than the best by this log-likelihood, as it counts, are not looked at any closer."""
_POOL, _OF_EXPOSURE, _REFINED = 120, 12, 6
"""Candidates that are looked at, of these with one exposure, and refined."""
_SPREADS = (0.5, 0.25, 0.12, 0.06, 0.03, 0.015, 0.008, 0.004, 0.002)
"""Shares of the exposure, or of _ROW_STEP_NS, by which the shutter may be off."""
_ROW_STEP_NS = 10_000.0
_PLAIN = np.array([0.9, 1.0, 1.1])
"""Tone curves that are tried until the time is nearly known."""
_RESPONSES_NS = (0.3e6, 1.5e6, 4e6)
"""Time constants of screens' cells, quick (OLED) to slow."""


class PanelUnreadableError(PanelNotFoundError):
    """A panel is in the picture, but its time cannot be told; the message says why."""


@dataclass(frozen=True, slots=True)
class Freedom:
    """What of the shutter is not known, and so is found with the time."""

    exposure: bool
    row_time: bool

    def near(
        self, shutter: Shutter, factors: "tuple[float, ...]", steps_ns: "tuple[float, ...]"
    ) -> list[Shutter]:
        """The shutter with what is free changed by each of the factors and steps."""
        return [
            Shutter(shutter.exposure_ns * factor, shutter.row_time_ns + step_ns)
            for factor in (factors if self.exposure else (1.0,))
            for step_ns in (steps_ns if self.row_time else (0.0,))
            if shutter.row_time_ns + step_ns >= 0
        ]


class Posterior:
    """Chances of times, gathered from the neighbourhoods of candidates; `best` is the likeliest."""

    def __init__(self, best: Candidate) -> None:
        self.best = best
        self._times: list[Floats] = []
        self._logs: list[Floats] = []
        self._row_times: list[tuple[float, float]] = []

    def holds(self, time_ns: float) -> bool:
        """Whether a time lies within a neighbourhood that it has."""
        return any(times[0] <= time_ns <= times[-1] for times in self._times)

    def add(self, times: Floats, logs: "dict[Shutter, Floats]") -> None:
        """Add a neighbourhood: evenly spaced times and, by shutter, the logarithms of their chances."""
        self._times.append(times)
        self._logs.append(np.logaddexp.reduce(list(logs.values()), axis=0))
        if len(self._times) == 1:
            self._row_times = [(s.row_time_ns, float(np.logaddexp.reduce(log))) for s, log in logs.items()]

    def row_time(self) -> tuple[float, float]:
        """Row time of the best neighbourhood and its 95 % error, in ns."""
        row_times, logs = np.array(self._row_times).T
        chances = np.exp(logs - logs.max())
        mean = float(np.average(row_times, weights=chances))
        spread = float(np.sqrt(np.average((row_times - mean) ** 2, weights=chances)))
        return mean, 1.96 * spread

    def interval(self) -> tuple[float, float]:
        """Middle and half width of the 95 % of the likeliest neighbourhood.

        Raises PanelUnreadableError where another one is nearly as likely, or where it has no ends.
        """
        top = max(float(log.max()) for log in self._logs)
        rival = _RIVAL_TEMPER / TEMPER
        number = max(range(len(self._logs)), key=lambda n: float(self._logs[n].max()))
        times, chances = self._times[number], np.exp(self._logs[number] - top)
        rivals = 0.0
        for other, log in zip(self._times, self._logs, strict=True):
            outside = (other < times[0]) | (other > times[-1])
            rivals += float(np.exp(rival * (log - top))[outside].sum()) * (other[1] - other[0])
        if rivals > _RIVAL * float(chances.sum()) * (times[1] - times[0]):
            raise PanelUnreadableError("two times are about as likely")
        if max(chances[0], chances[-1]) > _OPEN * chances.max():
            raise PanelUnreadableError(
                "its lamps look the same over too long a time, as in an exposure of whole turns of the panel"
            )
        summed = np.cumsum(chances) / chances.sum()
        low, high = (float(np.interp(q, summed, times)) for q in ((1 - SHARE) / 2, (1 + SHARE) / 2))
        return (low + high) / 2, (high - low) / 2


def gather(model: LightModel, candidates: list[Candidate], free: Freedom) -> Posterior:
    """How likely the times near the best candidates are."""
    tick_ns = model.panel.tick_ns
    pool = [_refine(model, one, Freedom(False, False), tick_ns, 25) for one in _pool(candidates)]
    pool.sort(key=lambda one: -one.score)
    chosen: list[Candidate] = []
    for one in pool:
        near = [n for n in chosen if abs(n.middle_ns - one.middle_ns) < tick_ns]
        if len(near) < 2 and len(chosen) < _REFINED:
            chosen.append(one)
    refined = [_refine_shutter(model, one, free) for one in chosen]
    refined.sort(key=lambda one: -one.score)
    posterior = Posterior(refined[0])
    for one in refined:
        if one.score > refined[0].score - _WORTH / TEMPER and not posterior.holds(one.middle_ns):
            # What the shutter is matters for the width of the best one only.
            posterior.add(*_neighbourhood(model, one, free if one is refined[0] else Freedom(False, False)))
    return posterior


def _pool(candidates: list[Candidate]) -> list[Candidate]:
    """The best candidates, of each exposure some: the search is too coarse to tell exposures apart."""
    by_exposure: dict[float, int] = {}
    pool: list[Candidate] = []
    for one in candidates:
        exposure_ns = one.shutter.exposure_ns
        by_exposure[exposure_ns] = by_exposure.get(exposure_ns, 0) + 1
        if by_exposure[exposure_ns] <= _OF_EXPOSURE and len(pool) < _POOL:
            pool.append(one)
    return pool


def _refine_shutter(model: LightModel, one: Candidate, free: Freedom) -> Candidate:
    reach_ns, factor, step_ns = model.panel.tick_ns, 1.25, 3_000.0
    for turn in range(7 if free.exposure or free.row_time else 2):
        one = _refine(model, one, free, reach_ns, 33, (1 / factor, 1.0, factor), (-step_ns, 0.0, step_ns))
        reach_ns = max(reach_ns / 2, 0.1 * model.panel.tick_ns)
        if turn > 1:
            factor, step_ns = factor**0.6, step_ns * 0.6
    return one


def _refine(
    model: LightModel,
    one: Candidate,
    free: Freedom,
    reach_ns: float,
    count: int,
    factors: "tuple[float, ...]" = (1.0,),
    steps_ns: "tuple[float, ...]" = (0.0,),
) -> Candidate:
    """The likeliest of times within reach of a candidate, and of shutters near to its own."""
    _, on = model.rough_fit()
    times = one.middle_ns + np.linspace(-reach_ns, reach_ns, count)
    response_ns = _RESPONSES_NS[1] if model.panel.is_screen else 0.0
    best: list[Candidate] = []
    for shutter in free.near(one.shutter, factors, steps_ns):
        shares = model.shares(times, shutter, response_ns=response_ns)
        likelihood = model.fit(shares, on, _PLAIN).likelihood
        at = int(np.argmax(likelihood))
        best.append(replace(one, middle_ns=float(times[at]), shutter=shutter, score=float(likelihood[at])))
    return max(best, key=lambda each: each.score)


def _neighbourhood(
    model: LightModel, one: Candidate, free: Freedom
) -> "tuple[Floats, dict[Shutter, Floats]]":
    """Times around a candidate and, by shutter that may be, the logarithms of their chances."""
    _, on = model.rough_fit()
    reach_ns = 1.5 * model.panel.tick_ns
    if not model.panel.is_screen:
        # The longer the exposure, the less its ends show.
        reach_ns += 0.06 * one.shutter.exposure_ns
    free_count = int(free.exposure) + int(free.row_time)
    times = one.middle_ns + np.linspace(-reach_ns, reach_ns, _TIMES if not free_count else _TIMES // 2)
    steps = np.arange(-2.0, 3.0)
    factors, steps_ns = (1.0,), (0.0,)
    if free.exposure:
        spread = _spread(model, one, times, [(f, 0.0) for f in _SPREADS], Freedom(True, False))
        factors = tuple((1 + spread) ** steps)
    if free.row_time:
        spread = _spread(model, one, times, [(0.0, f) for f in _SPREADS], Freedom(False, True))
        steps_ns = tuple(spread * _ROW_STEP_NS * steps)
    tones = _PLAIN if free_count else TONES
    found: dict[Shutter, Floats] = {}
    for shutter in free.near(one.shutter, factors, steps_ns):
        of_responses = [
            TEMPER * model.fit(model.shares(times, shutter, response_ns=response_ns), on, tones).likelihood
            for response_ns in (_RESPONSES_NS if model.panel.is_screen else (0.0,))
        ]
        found[shutter] = np.logaddexp.reduce(of_responses, axis=0)
    return times, found


def _spread(
    model: LightModel, one: Candidate, times: Floats, tried: "list[tuple[float, float]]", free: Freedom
) -> float:
    """About one sigma of exposure or row time, of the steps tried (largest first): where chances fall."""
    few = times[:: max(1, len(times) // 60)]
    reach_ns, count = float(few[-1] - few[0]) / 2, len(few)
    centre = _refine(model, one, Freedom(False, False), reach_ns, count).score
    for factor, step in tried:
        around = [
            _refine(model, one, free, reach_ns, count, (f,), (s,)).score
            for f, s in ((1 + factor, step * _ROW_STEP_NS), (1 / (1 + factor), -step * _ROW_STEP_NS))
            if one.shutter.row_time_ns + s >= 0
        ]
        if TEMPER * (centre - max(around, default=centre)) < 1.0:
            return max(factor, step)
    return max(tried[-1])
