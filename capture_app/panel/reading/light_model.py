"""How much of an exposure each lamp of a panel should shine, and how well that fits what a picture shows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_app.panel.pattern import COUNT, Panel
from capture_app.panel.reading.lamp_light import LampLight

Floats = NDArray[np.float64]

TONES = np.linspace(0.8, 1.25, 7)
"""Exponents by which cameras' tone curves differ from sRGB's."""
_TONE_SIGMA = 0.12
_UNEVEN = 0.07
"""Lamps differ in brightness by this, and pictures get darker to the corners."""
_FLOOR = 0.012
"""What blur brings from one lamp to the next, as a share of a lamp's light."""
_GLARE = 0.06
"""Share of a spot of glare that is not seen beside the lamp."""
_OFFSET_SIGMA = 0.03
"""Of the light that lamps throw back when they are off, against the ground beside them."""
_LAGS = np.array([0.137, 0.476, 0.999, 2.387])
"""Means of the quarters of an exponential law."""
_FREEDOM = 5.0
"""Of Student's law for the misfit of a lamp, so that a few that something covers do not decide."""


@dataclass(frozen=True, slots=True)
class Shutter:
    """How a picture was exposed: for how long, and how long after each row the next one begins, in ns."""

    exposure_ns: float
    row_time_ns: float


class LightModel:
    """A panel's lamps in one picture; times are of the middle of the exposure of the row `row`, in ns."""

    def __init__(self, panel: Panel, seen: LampLight) -> None:
        lamps = panel.lamps
        self.panel, self.seen = panel, seen
        self.group = np.array([lamp.group for lamp in lamps])
        self.start = np.array([(lamp.start + lamp.delay) * panel.tick_ns for lamp in lamps])
        self.lit = np.array([lamp.lit * panel.tick_ns for lamp in lamps])
        self.period = np.array([lamp.period * panel.tick_ns for lamp in lamps])
        ground = seen.ground
        self._still = seen.noise**2 + (_GLARE * (ground - np.median(ground))) ** 2
        self.row = float(seen.rows.mean())
        self.later = seen.rows - self.row
        self._rough = self._find_rough_fit()

    def shares(
        self,
        middle_ns: Floats,
        shutter: Shutter,
        of: "NDArray[np.bool_] | slice" = slice(None),
        response_ns: float = 0.0,
        lines: slice = slice(None),
    ) -> Floats:
        """Share (times, lamps) of its exposure in which each lamp, or each `of` them, shines on `lines`.

        A screen's cells change with that time constant, and are on the whole as late: the panel's time is
        that which its cells show.
        """
        if response_ns:
            lags = response_ns * (_LAGS - 1)
            return np.asarray(sum(self.shares(middle_ns - lag, shutter, of) for lag in lags) / len(lags))
        later = self.later[of][:, lines]
        begin = middle_ns[:, None, None] - shutter.exposure_ns / 2 + later * shutter.row_time_ns
        start, lit, period = (each[of][:, None] for each in (self.start, self.lit, self.period))
        begin = begin - start

        def lit_until(time: Floats) -> Floats:
            turns = np.floor(time / period)
            return np.asarray(turns * lit + np.minimum(time - turns * period, lit))

        exposure_ns = shutter.exposure_ns
        return np.asarray((lit_until(begin + exposure_ns) - lit_until(begin)).mean(axis=2) / exposure_ns)

    def variance(
        self, shares: Floats, lamp_light: float, of: "NDArray[np.bool_] | slice" = slice(None)
    ) -> Floats:
        """Variance of each lamp's light where a lamp that is lit all the time has `lamp_light`."""
        return np.asarray(self._still[of] + lamp_light**2 * (_FLOOR**2 + (_UNEVEN * shares) ** 2))

    def rough_fit(self) -> tuple[float, float]:
        """The light of a lamp that is off, and of one that is lit all the time, before the time is known.

        At any time one lamp of each group is lit in each row, so that their light adds up to one lamp's; but
        not in a group that goes on as quickly as the rows of a picture in which it lies on its side.
        """
        return self._rough

    def _find_rough_fit(self) -> tuple[float, float]:
        light = self.seen.light
        off = float(np.sort(light)[: len(light) // 5].mean())
        sums = [float((light[self.group == group] - off).mean()) * COUNT for group in np.unique(self.group)]
        return off, max(float(np.median(sums)), float(np.percentile(light, 98)) - off)

    def fit(self, shares: Floats, lamp_light: float, tones: Floats = TONES) -> "Fit":
        """How well each row of `shares` (times, lamps) fits, at the tone curve that fits best."""
        best: Fit | None = None
        for tone in tones:
            fit = self._fit_tone(shares, lamp_light, float(tone))
            best = fit if best is None else best.better(fit)
        assert best is not None, "there are tones"
        return best

    def _fit_tone(self, shares: Floats, lamp_light: float, tone: float) -> "Fit":
        ground = np.maximum(self.seen.ground, 1e-4)
        total = np.maximum(self.seen.light + ground, 1e-5)
        # Kept as bright at a lit lamp's level, so that variances hold for all tones.
        scale = lamp_light / max(1e-6, (lamp_light + float(ground.mean())) ** tone)
        light = (total**tone - ground**tone) * scale
        variance = self.variance(shares, lamp_light)
        weight = 1 / variance
        prior = 1 / (_OFFSET_SIGMA * max(lamp_light, 0.1)) ** 2
        one, per_share = weight.sum(axis=1) + prior, (weight * shares).sum(axis=1)
        square = (weight * shares**2).sum(axis=1)
        seen, both = weight @ light, (weight * shares) @ light
        root = np.maximum(one * square - per_share**2, 1e-9 * one * square + 1e-12)
        on = np.clip((one * both - per_share * seen) / root, 0.3 * lamp_light, 3 * lamp_light)
        off = (seen - on * per_share) / one
        misfit = light - off[:, None] - on[:, None] * shares
        # Of a lamp that is too bright to tell is only known that it is at least so bright.
        misfit = np.where(self.seen.saturated & (misfit < 0), 0.0, misfit)
        z = misfit / np.sqrt(variance)
        law = (_FREEDOM + 1) / 2 * np.log1p(z**2 / _FREEDOM) + 0.5 * np.log(variance)
        likelihood = -law.sum(axis=1) - 0.5 * prior * off**2 - 0.5 * ((tone - 1) / _TONE_SIGMA) ** 2
        return Fit(likelihood, z, on)


@dataclass(frozen=True, slots=True)
class Fit:
    """How well each of several times fits: log-likelihoods (times,) and misfits in sigmas (times, lamps)."""

    likelihood: Floats
    misfit: Floats
    on: Floats
    """Light of a lamp that is lit all the time, (times,)."""

    def better(self, other: "Fit") -> "Fit":
        """For each time the better of both."""
        worse = self.likelihood < other.likelihood
        return Fit(
            np.where(worse, other.likelihood, self.likelihood),
            np.where(worse[:, None], other.misfit, self.misfit),
            np.where(worse, other.on, self.on),
        )
