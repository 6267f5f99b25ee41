"""Reads the time off a picture of a panel, with an error bar, or says why it cannot.

A whole cycle of the panel is searched, then how likely each time near the best ones is.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.common.text import duration
from capture_app.panel.finder import Floats, PanelNotFoundError, find_panel
from capture_app.panel.light_model import LINES, TONES, LightModel, Shutter
from capture_app.panel.pattern import COUNT, Panel

SIGMAS_95 = 1.96
STEPS = 8
"""Times tried for each tick."""
_MIDDLE_LINE = slice(LINES // 2, LINES // 2 + 1)
_GROUP_STEPS = 16
"""Times tried for each lamp of a group at most: they are further apart for those that are lit longer."""
SHORTEST_NS, LONGEST_NS, LONGEST_ROW_NS = 50e3, 24e6, 36e3
"""Exposures and row times that a camera may have that does not tell them."""
CANDIDATES, FEW_CANDIDATES = 12, 4
"""How many times are kept of a shutter that is known, and of each that may be."""
TEMPER = 0.55
"""Misfits of neighbouring lamps have causes in common: so much of their log-likelihood counts."""
SHARE = 0.95
"""Share of the cases in which the time is within its error bar."""
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
_MISFIT = 4.0
_MAX_MISFITS = 0.12
"""A panel of which more lamps than this share misfit by as many sigmas is not what its markers say."""
_MAX_RMS, _SCREEN_MAX_RMS = 1.3, 3.5
"""A panel whose lamps misfit by more sigmas on the whole is not it either; usual are 0.3 to 1, of slow
screens 2."""
_MAX_TICKS = 2.0
"""An error bar of more ticks of LEDs tells no time that they are for."""
_MIN_CONTRAST, _MIN_LIGHT = 4.0, 0.005
"""Lamps that are lit must stand out by this factor from the noise, and by this share of a full sensor."""
_SCREEN_MODEL_TICKS = 0.06
"""What is not known of how a screen draws and how slowly its cells change, in refreshes."""
_LED_MODEL_NS = 6_000.0
"""What is not known of where lamps' middles are, and of the switching of LEDs."""
_PLACE_SHARE = 1.0
"""How far all lamps may be off together, as a share of the error of the markers' corners."""
_UNSEEN_BEND = 0.12
"""Pitches by which a lens may bend a panel of which only three markers are seen."""
_TONE_SHARE = 0.12
"""By how much a tone curve may misjudge the share for which a lamp was lit."""


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
    times_ns = np.asarray(times * step_ns, float)
    groups = [_group_scores(model, number, times_ns) for number in np.unique(model.group)]
    found: list[Candidate] = []
    for shutter in shutters:
        score = np.zeros(len(times))
        for scores in groups:
            score += scores(shutter)
        for _ in range(CANDIDATES if len(shutters) == 1 else FEW_CANDIDATES):
            best = int(np.argmax(score))
            found.append(Candidate(best * step_ns, shutter, float(score[best])))
            score[np.arange(best - STEPS, best + STEPS + 1) % len(score)] = -np.inf
    found.sort(key=lambda one: -one.score)
    return found


def _group_scores(model: LightModel, number: int, times_ns: Floats) -> Callable[[Shutter], Floats]:
    """How well lamps that are lit by turns fit at each of the times (ns) that are searched, by shutter."""
    of = model.group == number
    off, on = model.rough_fit
    period_ns, lit_ns = float(model.period[of][0]), float(model.lit[of][0])
    bins = COUNT * min(round(lit_ns / model.panel.tick_ns * STEPS), _GROUP_STEPS)
    middles_ns = (np.arange(bins) + 0.5) * period_ns / bins
    bin_of = (times_ns / period_ns * bins).astype(int) % bins

    def scores(shutter: Shutter) -> Floats:
        """Log-likelihoods of the times, each the best of its own and its neighbours' of these lamps."""
        shares = model.shares(middles_ns, shutter, of, lines=_MIDDLE_LINE)
        variance = model.variance(shares, on, of)
        misfit = model.light[of] - off - on * shares
        misfit = np.where(model.saturated[of] & (misfit < 0), 0.0, misfit)
        score = -(3 * np.log1p(misfit**2 / variance / 5) + 0.5 * np.log(variance)).sum(axis=1)
        # Time is coarse here: what a neighbour can be, this may be.
        score = np.maximum(score, np.maximum(np.roll(score, 1), np.roll(score, -1)))
        return np.asarray(score[bin_of])

    return scores


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
        return mean, SIGMAS_95 * spread

    def interval(self) -> tuple[float, float]:
        """Middle and half width of the 95 % of the likeliest neighbourhood.

        Raises PanelNotFoundError where another one is nearly as likely, or where it has no ends.
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
            raise PanelNotFoundError("two times are about as likely")
        if max(chances[0], chances[-1]) > _OPEN * chances.max():
            raise PanelNotFoundError(
                "its lamps look the same over too long a time, as in an exposure of whole turns of the panel"
            )
        summed = np.cumsum(chances) / chances.sum()
        low, high = (float(np.interp(q, summed, times)) for q in ((1 - SHARE) / 2, (1 + SHARE) / 2))
        return (low + high) / 2, (high - low) / 2


def gather(
    model: LightModel, candidates: list[Candidate], frees_exposure: bool, frees_row: bool
) -> Posterior:
    """How likely the times near the best candidates are, with exposure and row time where they are free."""
    tick_ns = model.panel.tick_ns
    pool = [_refine(model, one, tick_ns, 25) for one in _pool(candidates)]
    pool.sort(key=lambda one: -one.score)
    chosen: list[Candidate] = []
    for one in pool:
        near = [n for n in chosen if abs(n.middle_ns - one.middle_ns) < tick_ns]
        if len(near) < 2 and len(chosen) < _REFINED:
            chosen.append(one)
    refined = [_refine_shutter(model, one, frees_exposure, frees_row) for one in chosen]
    refined.sort(key=lambda one: -one.score)
    posterior = Posterior(refined[0])
    for one in refined:
        if one.score > refined[0].score - _WORTH / TEMPER and not posterior.holds(one.middle_ns):
            # What the shutter is matters for the width of the best one only.
            best = one is refined[0]
            posterior.add(*_neighbourhood(model, one, best and frees_exposure, best and frees_row))
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


def _refine_shutter(model: LightModel, one: Candidate, frees_exposure: bool, frees_row: bool) -> Candidate:
    reach_ns, factor, step_ns = model.panel.tick_ns, 1.25, 3_000.0
    for turn in range(7 if frees_exposure or frees_row else 2):
        factors = (1 / factor, 1.0, factor) if frees_exposure else (1.0,)
        steps_ns = (-step_ns, 0.0, step_ns) if frees_row else (0.0,)
        one = _refine(model, one, reach_ns, 33, factors, steps_ns)
        reach_ns = max(reach_ns / 2, 0.1 * model.panel.tick_ns)
        if turn > 1:
            factor, step_ns = factor**0.6, step_ns * 0.6
    return one


def _refine(
    model: LightModel,
    one: Candidate,
    reach_ns: float,
    count: int,
    factors: "tuple[float, ...]" = (1.0,),
    steps_ns: "tuple[float, ...]" = (0.0,),
) -> Candidate:
    """The likeliest of times within reach of a candidate, and of shutters near to its own."""
    _, on = model.rough_fit
    times = one.middle_ns + np.linspace(-reach_ns, reach_ns, count)
    response_ns = _RESPONSES_NS[1] if model.panel.is_screen else 0.0
    best: list[Candidate] = []
    for shutter in _near(one.shutter, factors, steps_ns):
        shares = model.shares(times, shutter, response_ns=response_ns)
        likelihood, _ = model.fit(shares, on, _PLAIN)
        at = int(np.argmax(likelihood))
        best.append(replace(one, middle_ns=float(times[at]), shutter=shutter, score=float(likelihood[at])))
    return max(best, key=lambda each: each.score)


def _near(shutter: Shutter, factors: "tuple[float, ...]", steps_ns: "tuple[float, ...]") -> Iterator[Shutter]:
    """The shutter with its exposure changed by each of the factors, its row time by each of the steps."""
    for factor, step_ns in product(factors, steps_ns):
        if shutter.row_time_ns + step_ns >= 0:
            yield Shutter(shutter.exposure_ns * factor, shutter.row_time_ns + step_ns)


def _neighbourhood(
    model: LightModel, one: Candidate, frees_exposure: bool, frees_row: bool
) -> "tuple[Floats, dict[Shutter, Floats]]":
    """Times around a candidate and, by shutter that may be, the logarithms of their chances."""
    _, on = model.rough_fit
    reach_ns = 1.5 * model.panel.tick_ns
    if not model.panel.is_screen:
        # The longer the exposure, the less its ends show.
        reach_ns += 0.06 * one.shutter.exposure_ns
    frees = frees_exposure or frees_row
    times = one.middle_ns + np.linspace(-reach_ns, reach_ns, _TIMES // 2 if frees else _TIMES)
    steps = np.arange(-2.0, 3.0)
    factors, steps_ns = (1.0,), (0.0,)
    if frees_exposure:
        spread = _spread(model, one, times, [(f, 0.0) for f in _SPREADS])
        factors = tuple((1 + spread) ** steps)
    if frees_row:
        spread = _spread(model, one, times, [(0.0, f) for f in _SPREADS])
        steps_ns = tuple(spread * _ROW_STEP_NS * steps)
    tones = _PLAIN if frees else TONES
    found: dict[Shutter, Floats] = {}
    for shutter in _near(one.shutter, factors, steps_ns):
        of_responses = [
            TEMPER * model.fit(model.shares(times, shutter, response_ns=response_ns), on, tones)[0]
            for response_ns in (_RESPONSES_NS if model.panel.is_screen else (0.0,))
        ]
        found[shutter] = np.logaddexp.reduce(of_responses, axis=0)
    return times, found


def _spread(model: LightModel, one: Candidate, times: Floats, tried: "list[tuple[float, float]]") -> float:
    """About one sigma of exposure or row time, of the steps tried (largest first): where chances fall."""
    few = times[:: max(1, len(times) // 60)]
    reach_ns, count = float(few[-1] - few[0]) / 2, len(few)
    centre = _refine(model, one, reach_ns, count).score
    for factor, step in tried:
        around = [
            _refine(model, one, reach_ns, count, (f,), (s,)).score
            for f, s in ((1 + factor, step * _ROW_STEP_NS), (1 / (1 + factor), -step * _ROW_STEP_NS))
            if one.shutter.row_time_ns + s >= 0
        ]
        if TEMPER * (centre - max(around, default=centre)) < 1.0:
            return max(factor, step)
    return max(tried[-1])


@dataclass(frozen=True, slots=True)
class PanelTime:
    """When a picture was taken by a panel, in ns of its cycle."""

    panel: Panel
    middle_ns: float
    """Middle of the exposure of row `row`."""
    uncertainty_ns: float
    """The middle is within this with a chance of 95 %."""
    row: float
    """Row of the picture in which the panel's middle lies."""
    shutter: Shutter
    """The shutter as it was told, or as it fits best."""
    row_time_error_ns: float
    """The row time is within this with a chance of 95 %; 0 where it was told."""
    markers: int
    misfit: float
    """Root mean square misfit of the lamps, in sigmas."""

    def at_row(self, row: float) -> tuple[float, float]:
        """Middle of that row's exposure, in ns of the panel, and its 95 % error."""
        away = row - self.row
        error_ns = float(np.hypot(self.uncertainty_ns, away * self.row_time_error_ns))
        return self.middle_ns + away * self.shutter.row_time_ns, error_ns


def read_panel(
    picture: NDArray[np.uint8], *, exposure_ns: float | None = None, row_time_ns: float | None = None
) -> PanelTime:
    """The time that a panel tells in a picture (uint8, BGR); nobody need say which panel or where it is.

    Exposure and row time that are None are found with it. Raises PanelNotFoundError where there is no panel,
    and where it tells no time or not one time.
    """
    found = find_panel(np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8))
    model = LightModel(found, picture)
    _, on = model.rough_fit
    dark, bright = np.percentile(model.light, (20, 97))
    if bright - dark < _MIN_CONTRAST * model.noise + _MIN_LIGHT:
        raise PanelNotFoundError(
            "its lamps do not stand out: too dark, too short an exposure, or switched off"
        )
    shutters = possible_shutters(found.panel, exposure_ns, row_time_ns)
    posterior = gather(model, search(model, shutters), exposure_ns is None, row_time_ns is None)
    best = posterior.best
    shares = model.shares(np.array([best.middle_ns]), best.shutter)
    misfit = model.fit(shares, on)[1][0]
    wrong = float((np.abs(misfit) > _MISFIT).mean())
    rms = float(np.sqrt(np.mean(np.minimum(misfit**2, 25))))
    if wrong > _MAX_MISFITS or rms > (_SCREEN_MAX_RMS if found.panel.is_screen else _MAX_RMS):
        raise PanelNotFoundError(
            f"its lamps do not shine as those of {found.panel.name} would at any time: is it that panel, are "
            "exposure and row time right, is it hidden or too blurred?"
        )
    middle_ns, spread_ns = posterior.interval()
    if found.panel.is_screen:
        model_ns = _SCREEN_MODEL_TICKS * found.panel.tick_ns
    else:
        partly_ns = min(best.shutter.exposure_ns, found.panel.tick_ns)
        # Where a lamp's middle is misjudged, so is the time of its row.
        place = found.error if found.markers == 4 else found.error + _UNSEEN_BEND
        place_ns = _PLACE_SHARE * place * found.pitch_px * best.shutter.row_time_ns
        model_ns = float(np.linalg.norm([_LED_MODEL_NS, _TONE_SHARE * partly_ns, place_ns]))
    row_time_ns, row_time_error_ns = posterior.row_time()
    uncertainty_ns = float(np.hypot(spread_ns, model_ns)) * max(1.0, rms)
    if not found.panel.is_screen and uncertainty_ns > _MAX_TICKS * found.panel.tick_ns:
        raise PanelNotFoundError(
            f"its time is known to ±{duration(uncertainty_ns)} only: expose shorter, not whole "
            "turns of the panel"
        )
    return PanelTime(
        found.panel,
        middle_ns % found.panel.cycle_ns,
        uncertainty_ns,
        model.row,
        Shutter(best.shutter.exposure_ns, row_time_ns),
        row_time_error_ns,
        found.markers,
        rms,
    )
