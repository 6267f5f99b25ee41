"""Time reading from an image of a panel, with its uncertainty or the reason for a refusal.

A coarse search covers a whole cycle of the panel; the likelihood is then evaluated in detail near the best
times.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain, product

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.common.grouping import grouped
from capture_app.common.text import duration
from capture_app.companions.panel.cycle_code import Cycle
from capture_app.companions.panel.cycle_reading import read_cycle
from capture_app.companions.panel.finder import Floats, PanelNotFoundError, find_panel
from capture_app.companions.panel.light_model import LINES, TONES, LightModel, Shutter
from capture_app.companions.panel.pattern import COUNT, Panel

SIGMAS_95 = 1.96
STEPS = 8
"""Search steps per tick."""
_GROUP_STEPS = 16
"""Maximum search steps per lamp of a group; steps are wider for lamps with a longer lit time."""
SHORTEST_NS = 50e3
LONGEST = Shutter(24e6, 36e3)
"""Range of exposures, and maximum row time, for cameras of which nothing is known."""
CANDIDATES, FEW_CANDIDATES = 12, 4
"""Number of candidate times for a known shutter, and for each of several possible shutters."""
TEMPER = 0.55
"""Weight of the log-likelihood, because residuals of neighbouring lamps are correlated."""
COVERAGE = 0.95
"""Coverage of the reported uncertainty interval."""
_RIVAL, _RIVAL_TEMPER = 0.005, 0.6
"""Probability of a distant time at which a reading is refused, and the weight of its log-likelihood. Other
lamps decide between distant times, so the weight is higher than TEMPER."""
_OPEN = 0.05
"""Relative probability at a neighbourhood's ends above which it does not bound the time."""
_TIMES = 301
_WORTH = 25.0
"""Weighted log-likelihood deficit beyond which candidates are not examined further."""
_POOL, _OF_EXPOSURE, _REFINED = 120, 12, 6
"""Maximum candidates examined, examined per exposure, and refined."""
_SPREADS = (0.5, 0.25, 0.12, 0.06, 0.03, 0.015, 0.008, 0.004, 0.002)
"""Possible shutter errors, as fractions of the exposure or of _ROW_STEP_NS."""
_ROW_STEP_NS = 10_000.0
_PLAIN = np.array([0.9, 1.0, 1.1])
"""Tone curves tried until the time is nearly known."""
_RESPONSES_NS = (0.3e6, 1.5e6, 4e6)
"""Time constants of screen cells, fast (OLED) to slow."""
_OUTLIER_SIGMAS = 4.0
_MAX_OUTLIER_FRACTION = 0.12
"""Residual limit in sigmas, and the fraction of lamps beyond it at which the panel is not the one its markers
name."""
_MAX_RMS, _SCREEN_MAX_RMS = 1.3, 3.5
"""Maximum RMS residual in sigmas of LEDs and of screens. Typical values are 0.3 to 1, and 2 for slow
screens."""
_MAX_TICKS = 2.0
"""Maximum uncertainty of an LED panel's reading, in ticks."""
_MIN_CONTRAST, _MIN_LIGHT = 4.0, 0.005
"""Minimum contrast of lit lamps, as a multiple of the noise and as a fraction of full scale."""
_SCREEN_MODEL_TICKS = 0.06
"""Model uncertainty of a screen's drawing and cell response, in refreshes."""
_LED_MODEL_NS = 6_000.0
"""Model uncertainty of the lamps' centres and of LED switching."""
_UNSEEN_BEND = 0.12
"""Possible lens distortion in pitches of a panel with only three visible markers."""
_TONE_FRACTION = 0.12
"""Error that a tone curve may cause in a lamp's lit fraction."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Candidate reading of a panel: mid-exposure time of the image (ns of the panel's clock), and shutter."""

    middle_ns: float
    shutter: Shutter
    score: float


Range = tuple[Floats, dict[Shutter, Floats]]
"""Evenly spaced times (ns) near a candidate, and their log-probabilities by shutter."""


def possible_shutters(
    panel: Panel, exposure_ns: float | None, row_time_ns: float | None, longest: Shutter = LONGEST
) -> list[Shutter]:
    """Return the known shutter, or the shutters to try, up to `longest`, if a value is unknown."""
    cycle_ns = COUNT * panel.tick_ns
    if exposure_ns is not None:
        exposures = [float(exposure_ns)]
    else:
        exposures = np.geomspace(SHORTEST_NS, min(cycle_ns, longest.exposure_ns), 16).tolist()
        # Exposures longer than one cycle of all columns differ only by the excess over whole cycles.
        exposures += np.arange(cycle_ns * 1.2, longest.exposure_ns, cycle_ns / 5).tolist()
    if row_time_ns is not None:
        return [Shutter(exposure, float(row_time_ns)) for exposure in exposures]
    return [
        Shutter(exposure, row)
        for exposure in exposures
        for row in np.linspace(0, longest.row_time_ns, 7 if exposure > cycle_ns else 11).tolist()
    ]


def search(model: LightModel, shutters: "list[Shutter]") -> list[Hypothesis]:
    """Return the likeliest times of the cycle, best first; per shutter they are over a tick apart."""
    step_ns = model.panel.tick_ns / STEPS
    times_ns = np.asarray(np.arange(round(model.panel.cycle_ticks * STEPS)) * step_ns, float)
    groups = [_group_scores(model, number, times_ns) for number in np.unique(model.group)]
    hypotheses = []
    for shutter in shutters:
        score: Floats = np.sum([scores(shutter) for scores in groups], axis=0)
        for _ in range(CANDIDATES if len(shutters) == 1 else FEW_CANDIDATES):
            best = int(np.argmax(score))
            hypotheses.append(Hypothesis(best * step_ns, shutter, float(score[best])))
            score[np.arange(best - STEPS, best + STEPS + 1) % len(score)] = -np.inf
    return sorted(hypotheses, key=lambda one: -one.score)


def _group_scores(model: LightModel, number: int, times_ns: Floats) -> Callable[[Shutter], Floats]:
    """Return a function from shutter to one lamp group's log-likelihood at each search time (ns)."""
    members = model.group == number
    off, on = model.rough_fit
    period_ns, lit_ns = float(model.period[members][0]), float(model.lit[members][0])
    bins = COUNT * min(round(lit_ns / model.panel.tick_ns * STEPS), _GROUP_STEPS)
    middles_ns = (np.arange(bins) + 0.5) * period_ns / bins
    bin_of = (times_ns / period_ns * bins).astype(int) % bins

    def scores(shutter: Shutter) -> Floats:
        """Return log-likelihoods of the times, each the maximum over itself and its neighbours."""
        shares = model.shares(middles_ns, shutter, members, lines=slice(LINES // 2, LINES // 2 + 1))
        variance = model.variance(shares, on, members)
        residual = model.light[members] - off - on * shares
        residual = np.where(model.saturated[members] & (residual < 0), 0.0, residual)
        score = -(3 * np.log1p(residual**2 / variance / 5) + 0.5 * np.log(variance)).sum(axis=1)
        # The time grid is coarse: the true time may be at a neighbouring step.
        score = np.maximum(score, np.maximum(np.roll(score, 1), np.roll(score, -1)))
        return np.asarray(score[bin_of])

    return scores


def row_time(logs: dict[Shutter, Floats]) -> tuple[float, float]:
    """Return the image's row time and its 95 % uncertainty, in ns, from log-probabilities by shutter."""
    row_times = np.array([shutter.row_time_ns for shutter in logs])
    chances = np.logaddexp.reduce(list(logs.values()), axis=1)
    chances = np.exp(chances - chances.max())
    mean = float(np.average(row_times, weights=chances))
    return mean, SIGMAS_95 * float(np.sqrt(np.average((row_times - mean) ** 2, weights=chances)))


def interval(ranges: list[Range]) -> tuple[float, float]:
    """Return centre and half width of the 95 % interval, ns, in the likeliest range of times.

    Raises PanelNotFoundError if another range is nearly as likely, or if this range does not bound the time.
    """
    of_times = [(times, np.logaddexp.reduce(list(logs.values()), axis=0)) for times, logs in ranges]
    times, best = max(of_times, key=lambda one: float(one[1].max()))
    chances, rival = np.exp(best - best.max()), _RIVAL_TEMPER / TEMPER
    rivals = 0.0
    for other, log in of_times:
        outside = (other < times[0]) | (other > times[-1])
        rivals += float(np.exp(rival * (log - best.max()))[outside].sum()) * (other[1] - other[0])
    if rivals > _RIVAL * float(chances.sum()) * (times[1] - times[0]):
        raise PanelNotFoundError("its lamps fit two different times about equally well")
    if max(chances[0], chances[-1]) > _OPEN * chances.max():
        raise PanelNotFoundError(
            "its lamps look the same over too long a time, as in an exposure of whole cycles of the panel"
        )
    summed = np.cumsum(chances) / chances.sum()
    low, high = (float(np.interp(q, summed, times)) for q in ((1 - COVERAGE) / 2, (1 + COVERAGE) / 2))
    return (low + high) / 2, (high - low) / 2


def gather(
    model: LightModel, candidates: list[Hypothesis], frees_exposure: bool, frees_row: bool
) -> tuple[Hypothesis, list[Range]]:
    """Return the best candidate, and the ranges of times near it and its rivals, its own first.

    Exposure and row time are free where requested.
    """
    tick_ns = model.panel.tick_ns
    pool = [_refine(model, candidate, tick_ns, 25) for candidate in _pool(candidates)]
    chosen: list[Hypothesis] = []
    for one in sorted(pool, key=lambda one: -one.score):
        near = [n for n in chosen if abs(n.middle_ns - one.middle_ns) < tick_ns]
        if len(near) < 2 and len(chosen) < _REFINED:
            chosen.append(one)
    refined = [_refine_shutter(model, other, frees_exposure, frees_row) for other in chosen]
    best, *rivals = sorted(refined, key=lambda one: -one.score)
    ranges = [_neighbourhood(model, best, frees_exposure, frees_row)]
    for one in rivals:
        is_known = any(times[0] <= one.middle_ns <= times[-1] for times, _ in ranges)
        if one.score > best.score - _WORTH / TEMPER and not is_known:
            # The shutter's uncertainty matters only for the width of the best neighbourhood.
            ranges.append(_neighbourhood(model, one, frees_exposure=False, frees_row=False))
    return best, ranges


def _pool(candidates: list[Hypothesis]) -> list[Hypothesis]:
    """Return the best candidates with several per exposure, because the search cannot separate exposures."""
    by_exposure = grouped((one.shutter.exposure_ns, one) for one in candidates)
    pool = chain.from_iterable(some[:_OF_EXPOSURE] for some in by_exposure.values())
    return sorted(pool, key=lambda one: -one.score)[:_POOL]


def _refine_shutter(model: LightModel, one: Hypothesis, frees_exposure: bool, frees_row: bool) -> Hypothesis:
    half_ns, factor, step_ns = model.panel.tick_ns, 1.25, 3_000.0
    for round_number in range(7 if frees_exposure or frees_row else 2):
        one = _refine(
            model,
            one,
            half_ns,
            33,
            (1 / factor, 1.0, factor) if frees_exposure else (1.0,),
            (-step_ns, 0.0, step_ns) if frees_row else (0.0,),
        )
        half_ns = max(half_ns / 2, 0.1 * model.panel.tick_ns)
        if round_number > 1:
            factor, step_ns = factor**0.6, step_ns * 0.6
    return one


def _refine(
    model: LightModel,
    one: Hypothesis,
    half_ns: float,
    count: int,
    factors: "tuple[float, ...]" = (1.0,),
    steps_ns: "tuple[float, ...]" = (0.0,),
) -> Hypothesis:
    """Return the likeliest time near a candidate, over shutters near its own."""
    _, on = model.rough_fit
    times = one.middle_ns + np.linspace(-half_ns, half_ns, count)
    response_ns = _RESPONSES_NS[1] if model.panel.is_screen else 0.0
    best = []
    for shutter in _near(one.shutter, factors, steps_ns):
        likelihood, _ = model.fit(model.shares(times, shutter, response_ns=response_ns), on, _PLAIN)
        at = int(np.argmax(likelihood))
        best.append(Hypothesis(float(times[at]), shutter, float(likelihood[at])))
    return max(best, key=lambda each: each.score)


def _near(shutter: Shutter, factors: "tuple[float, ...]", steps_ns: "tuple[float, ...]") -> Iterator[Shutter]:
    """Yield the shutter with exposure scaled by each factor and row time shifted by each step."""
    for factor, step_ns in product(factors, steps_ns):
        if shutter.row_time_ns + step_ns >= 0:
            yield Shutter(shutter.exposure_ns * factor, shutter.row_time_ns + step_ns)


def _neighbourhood(model: LightModel, one: Hypothesis, frees_exposure: bool, frees_row: bool) -> Range:
    """Return times around a candidate, and their log-probabilities by possible shutter."""
    _, on = model.rough_fit
    half_ns = 1.5 * model.panel.tick_ns
    if not model.panel.is_screen:
        # The longer the exposure, the weaker its ends constrain the time.
        half_ns += 0.06 * one.shutter.exposure_ns
    frees = frees_exposure or frees_row
    times = one.middle_ns + np.linspace(-half_ns, half_ns, _TIMES // 2 if frees else _TIMES)
    steps = np.arange(-2.0, 3.0)
    factors, steps_ns = (1.0,), (0.0,)
    if frees_exposure:
        scale = _likelihood_width(model, one, times, [(f, 0.0) for f in _SPREADS])
        factors = tuple((1 + scale) ** steps)
    if frees_row:
        scale = _likelihood_width(model, one, times, [(0.0, f) for f in _SPREADS])
        steps_ns = tuple(scale * _ROW_STEP_NS * steps)
    tones = _PLAIN if frees else TONES
    likelihoods: dict[Shutter, Floats] = {}
    for shutter in _near(one.shutter, factors, steps_ns):
        of_responses = [
            TEMPER * model.fit(model.shares(times, shutter, response_ns=response_ns), on, tones)[0]
            for response_ns in (_RESPONSES_NS if model.panel.is_screen else (0.0,))
        ]
        likelihoods[shutter] = np.logaddexp.reduce(of_responses, axis=0)
    return times, likelihoods


def _likelihood_width(
    model: LightModel, one: Hypothesis, times: Floats, tried: "list[tuple[float, float]]"
) -> float:
    """Return about one sigma of exposure or row time: the largest step with a small likelihood loss."""
    few = times[:: max(1, len(times) // 60)]
    half_ns, count = float(few[-1] - few[0]) / 2, len(few)
    centre = _refine(model, one, half_ns, count).score
    for factor, step in tried:
        around = [
            _refine(model, one, half_ns, count, (f,), (s,)).score
            for f, s in ((1 + factor, step * _ROW_STEP_NS), (1 / (1 + factor), -step * _ROW_STEP_NS))
            if one.shutter.row_time_ns + s >= 0
        ]
        if TEMPER * (centre - max(around, default=centre)) < 1.0:
            return max(factor, step)
    return max(tried[-1])


@dataclass(frozen=True, slots=True)
class PanelTime:
    """Time of an image read from a panel, in ns of the panel's cycle."""

    panel: Panel
    middle_ns: float
    """Mid-exposure time of row `row`."""
    uncertainty_ns: float
    """95 % uncertainty of `middle_ns`."""
    row: float
    """Image row of the panel's centre."""
    shutter: Shutter
    """Given shutter, or the best-fitting one."""
    row_time_error_ns: float
    """95 % uncertainty of the row time; 0 if it was given."""
    markers: int
    residual: float
    """RMS residual of the lamps, in sigmas."""
    cycle: Cycle | None = None
    """Cycle that the code of a screen's panel shows; None if it shows none, or it is unreadable."""

    def at_row(self, row: float) -> tuple[float, float]:
        """Return a row's mid-exposure time in ns of the panel, and its 95 % uncertainty."""
        rows = row - self.row
        error_ns = float(np.hypot(self.uncertainty_ns, rows * self.row_time_error_ns))
        return self.middle_ns + rows * self.shutter.row_time_ns, error_ns


def read_panel(
    picture: NDArray[np.uint8],
    *,
    exposure_ns: float | None = None,
    row_time_ns: float | None = None,
    longest: Shutter = LONGEST,
) -> PanelTime:
    """Read the time of a panel in an image (uint8, BGR); finds the panel and identifies it.

    `exposure_ns` and `row_time_ns` are estimated where None, up to the values of `longest`. Raises
    PanelNotFoundError if no panel is visible, or if its time is unreadable or ambiguous.
    """
    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)
    placed = find_panel(grey)
    model = LightModel(placed, picture)
    _, on = model.rough_fit
    dark, bright = np.percentile(model.light, (20, 97))
    if bright - dark < _MIN_CONTRAST * model.noise + _MIN_LIGHT:
        raise PanelNotFoundError(
            "its lamps do not stand out: too dark, too short an exposure, or switched off"
        )
    candidates = search(model, possible_shutters(placed.panel, exposure_ns, row_time_ns, longest))
    best, ranges = gather(model, candidates, exposure_ns is None, row_time_ns is None)
    residual = model.fit(model.shares(np.array([best.middle_ns]), best.shutter), on)[1][0]
    wrong = float((np.abs(residual) > _OUTLIER_SIGMAS).mean())
    rms = float(np.sqrt(np.mean(np.minimum(residual**2, 25))))
    if wrong > _MAX_OUTLIER_FRACTION or rms > (_SCREEN_MAX_RMS if placed.panel.is_screen else _MAX_RMS):
        raise PanelNotFoundError(
            f"its lamps do not fit {placed.panel.name} at any time: is it that panel, are "
            "exposure and row time right, is it hidden or too blurred?"
        )
    middle_ns, posterior_ns = interval(ranges)
    if placed.panel.is_screen:
        model_ns = _SCREEN_MODEL_TICKS * placed.panel.tick_ns
    else:
        partly_ns = min(best.shutter.exposure_ns, placed.panel.tick_ns)
        # An error in a lamp's centre is an error in its row, and so in its time.
        place = placed.error if placed.markers == 4 else placed.error + _UNSEEN_BEND
        place_ns = place * placed.pitch_px * best.shutter.row_time_ns
        model_ns = float(np.linalg.norm([_LED_MODEL_NS, _TONE_FRACTION * partly_ns, place_ns]))
    row_time_ns, row_time_error_ns = row_time(ranges[0][1])
    uncertainty_ns = float(np.hypot(posterior_ns, model_ns)) * max(1.0, rms)
    if not placed.panel.is_screen and uncertainty_ns > _MAX_TICKS * placed.panel.tick_ns:
        raise PanelNotFoundError(
            f"its time is known to ±{duration(uncertainty_ns)} only: expose shorter, not whole "
            "cycles of the panel"
        )
    return PanelTime(
        placed.panel,
        middle_ns % placed.panel.cycle_ns,
        uncertainty_ns,
        model.row,
        Shutter(best.shutter.exposure_ns, row_time_ns),
        row_time_error_ns,
        placed.markers,
        rms,
        read_cycle(placed, grey),
    )
