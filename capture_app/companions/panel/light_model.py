"""Measured light of each lamp of a panel in an image, and its likelihood at a given time."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.common.srgb import to_linear
from capture_app.companions.panel.finder import Floats, FoundPanel
from capture_app.companions.panel.pattern import COUNT

LINES = 3
"""Parts of a lamp with separate exposure times: under a rolling shutter its top is exposed earlier."""
_CORE = 0.8
"""Fraction of a lamp's size within which its light is measured."""
_SAMPLES = 5
"""Samples across and down a lamp's core."""
_FULL = 250
"""Pixel level from which a sample counts as saturated."""
TONES = np.linspace(0.8, 1.25, 7)
"""Exponents relative to sRGB's tone curve that cameras' curves may have."""
_TONE_SIGMA = 0.12
_UNEVEN = 0.07
"""Relative variation of brightness between lamps, including vignetting."""
_FLOOR = 0.012
"""Light that blur spreads to a neighbouring lamp, as a fraction of a lamp's light."""
_GLARE = 0.06
"""Fraction of glare on a lamp that the ground beside it does not show."""
_OFFSET_SIGMA = 0.03
"""Standard deviation of the light an unlit lamp reflects, relative to the ground beside it."""
_LAGS = np.array([0.137, 0.476, 0.999, 2.387])
"""Means of the quarters of an exponential distribution."""
_FREEDOM = 5.0
"""Degrees of freedom of Student's t-distribution for lamp residuals; limits the weight of a few occluded
lamps."""


def measure(
    found: FoundPanel, picture: NDArray[np.uint8]
) -> tuple[Floats, Floats, NDArray[np.bool_], Floats, float]:
    """Measure each lamp's light in an image (uint8 BGR), in the colour channel with the highest contrast.

    Returns, in linear units: light (n,) above the adjacent ground; that ground (n,); saturation flags (n,);
    image rows (n, LINES) of the lamps' parts; and the standard deviation of a lamp's light from image noise.
    """
    lamps = found.panel.lamps
    middles = np.array([[lamp.x, lamp.y] for lamp in lamps])
    core = _core_places(found.panel.lamp_size * _CORE, square=found.panel.is_screen)
    levels = _sample(found, picture, middles, core)
    gaps = np.array([[x, y] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    around = _sample(found, picture, middles, gaps)
    saturated = (levels >= _FULL).mean(axis=1) > 0.2
    linear = to_linear(levels).mean(axis=1)
    ground = np.sort(to_linear(around), axis=1)[:, 1:3].mean(axis=1)
    light = linear - ground
    contrast = np.percentile(light, 98, axis=0) - np.percentile(light, 30, axis=0)
    channel = int(
        np.argmax(contrast * (1 - 0.9 * saturated.mean(axis=0) / max(0.02, float(saturated.mean()))))
    )
    # Noise from the differences between the ground samples around each lamp.
    differences = np.diff(to_linear(around)[:, :2, channel], axis=1)
    noise = float(np.median(np.abs(differences)) / 0.954) + 1e-4
    rows = np.sort(
        found.pixels((middles[:, None] + core).reshape(-1, 2))[:, 1].reshape(len(lamps), -1), axis=1
    )
    lines = np.stack([part.mean(axis=1) for part in np.array_split(rows, LINES, axis=1)], axis=1)
    return light[:, channel], ground[:, channel], saturated[:, channel], lines, noise


def _core_places(size: float, *, square: bool) -> Floats:
    """Return points (n, 2) spaced evenly over a lamp's core, relative to its centre."""
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    if not square:
        places = places[np.hypot(*places.T) <= 0.5]
    return np.asarray(places * size)


def _sample(found: FoundPanel, picture: NDArray[np.uint8], middles: Floats, around: Floats) -> Floats:
    """Return the image's levels (n, points, channels) at points around each lamp."""
    at = found.pixels((middles[:, None] + around).reshape(-1, 2)).astype(np.float32)
    x, y = (at[:, axis].reshape(len(middles), -1) for axis in (0, 1))
    seen = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, float).reshape(len(middles), len(around), -1)


def lags_ns(response_ns: float) -> Floats:
    """Return how late the quarters of a cell's light are, less their mean, for its time constant."""
    return np.asarray(response_ns * (_LAGS - 1))


@dataclass(frozen=True, slots=True)
class Shutter:
    """Shutter of an image: exposure time, and time from the start of one row to the next, in ns."""

    exposure_ns: float
    row_time_ns: float


class LightModel:
    """Light model of a panel in one image; times are mid-exposure times of the row `row`, in ns."""

    def __init__(self, found: FoundPanel, picture: NDArray[np.uint8]) -> None:
        self.panel = panel = found.panel
        lamps = panel.lamps
        self.light, self._ground, self.saturated, rows, self.noise = measure(found, picture)
        self.group = np.array([lamp.group for lamp in lamps])
        self.start = np.array([(lamp.start + lamp.delay) * panel.tick_ns for lamp in lamps])
        self.lit = np.array([lamp.lit * panel.tick_ns for lamp in lamps])
        self.period = np.array([lamp.period * panel.tick_ns for lamp in lamps])
        self._still = self.noise**2 + (_GLARE * (self._ground - np.median(self._ground))) ** 2
        self.row = float(rows.mean())
        self.later = rows - self.row
        self.rough_fit = self._find_rough_fit()
        """Light of an unlit and of a permanently lit lamp, estimated before the time is known."""

    def shares(
        self,
        middle_ns: Floats,
        shutter: Shutter,
        of: "NDArray[np.bool_] | slice" = slice(None),
        response_ns: float = 0.0,
        lines: slice = slice(None),
    ) -> Floats:
        """Return the fraction (times, lamps) of the exposure in which each selected lamp is lit, on `lines`.

        `of` selects the lamps. `response_ns` is the time constant of a screen's cells; its mean delay is
        removed, so that the panel's time is the time its cells show.
        """
        if response_ns:
            lags = lags_ns(response_ns)
            return np.asarray(sum(self.shares(middle_ns - lag, shutter, of) for lag in lags) / len(lags))
        start, lit, period = (each[of] for each in (self.start, self.lit, self.period))
        later_ns = self.later[of][:, lines].T * shutter.row_time_ns
        exposure_ns = shutter.exposure_ns

        def lit_until(time: Floats) -> Floats:
            cycles = np.floor(time / period)
            return np.asarray(cycles * lit + np.minimum(time - cycles * period, lit))

        lit_ns = np.zeros((len(middle_ns), len(start)))
        for line_later_ns in later_ns:
            begin = middle_ns[:, None] - exposure_ns / 2 + (line_later_ns - start)
            lit_ns += lit_until(begin + exposure_ns) - lit_until(begin)
        return lit_ns / (len(later_ns) * exposure_ns)

    def shares_in_steps(self, middle_ns: Floats, shutter: Shutter, response_ns: float) -> Floats:
        """Return the `shares` at times in equal steps, by interpolation where cells respond late: quicker."""
        step_ns, count = float(middle_ns[1] - middle_ns[0]), len(middle_ns)
        lags = lags_ns(response_ns) / step_ns
        before, after = math.ceil(lags.max()), math.ceil(-lags.min())
        wide_ns = middle_ns[0] + step_ns * np.arange(-before, count + after + 1)
        at_once, total = self.shares(wide_ns, shutter), np.zeros((count, len(self.start)))
        for lag in lags:
            place = math.floor(before - lag)
            part = before - lag - place
            early, late = (at_once[k : k + count] for k in (place, place + 1))
            total += (1 - part) * early + part * late
        return total / len(lags)

    def variance(
        self, shares: Floats, lamp_light: float, of: "NDArray[np.bool_] | slice" = slice(None)
    ) -> Floats:
        """Return each lamp's variance of light, given the light `lamp_light` of a permanently lit lamp."""
        return np.asarray(self._still[of] + lamp_light**2 * (_FLOOR**2 + (_UNEVEN * shares) ** 2))

    def _find_rough_fit(self) -> tuple[float, float]:
        # At any time one lamp of each group is lit in each row, so a group's light adds up to one lamp's.
        # This fails for a group along the image rows that advances as fast as the rows are read out.
        light = self.light
        off = float(np.sort(light)[: len(light) // 5].mean())
        sums = [float((light[self.group == group] - off).mean()) * COUNT for group in np.unique(self.group)]
        return off, max(float(np.median(sums)), float(np.percentile(light, 98)) - off)

    def fit(self, shares: Floats, lamp_light: float, tones: Floats = TONES) -> tuple[Floats, Floats]:
        """Fit each row of `shares` (times, lamps), the lit fractions at one time, with its best tone curve.

        Returns log-likelihoods (times,) and residuals in sigmas (times, lamps).
        """
        variance = self.variance(shares, lamp_light)
        weight = 1 / variance
        weighted = weight * shares
        prior = 1 / (_OFFSET_SIGMA * max(lamp_light, 0.1)) ** 2
        per_offset, per_fraction = weight.sum(axis=1) + prior, weighted.sum(axis=1)
        square = (weighted * shares).sum(axis=1)
        root = np.maximum(per_offset * square - per_fraction**2, 1e-9 * per_offset * square + 1e-12)
        deviation, log_deviation = np.sqrt(variance), 0.5 * np.log(variance).sum(axis=1)
        likelihoods, misfits = [], []
        for tone in tones:
            light = self._toned_light(lamp_light, float(tone))
            seen, both = weight @ light, weighted @ light
            on = np.clip((per_offset * both - per_fraction * seen) / root, 0.3 * lamp_light, 3 * lamp_light)
            off = (seen - on * per_fraction) / per_offset
            residual = light - off[:, None] - on[:, None] * shares
            # A saturated lamp gives only a lower limit on its light.
            residual[:, self.saturated] = np.maximum(residual[:, self.saturated], 0.0)
            z = residual / deviation
            law = (_FREEDOM + 1) / 2 * np.log1p(z**2 / _FREEDOM).sum(axis=1) + log_deviation
            likelihoods.append(-law - 0.5 * prior * off**2 - 0.5 * ((tone - 1) / _TONE_SIGMA) ** 2)
            misfits.append(z)
        scores = np.stack(likelihoods)
        best = scores.argmax(axis=0), np.arange(len(shares))
        return scores[best], np.stack(misfits)[best]

    def _toned_light(self, lamp_light: float, tone: float) -> Floats:
        """Return each lamp's light by a tone curve, normalized so that variances hold for all of them."""
        ground = np.maximum(self._ground, 1e-4)
        total = np.maximum(self.light + ground, 1e-5)
        scale = lamp_light / max(1e-6, (lamp_light + float(ground.mean())) ** tone)
        return np.asarray((total**tone - ground**tone) * scale)
