"""What injections did to a camera's phase, and the profile of the device that explains it best.

shift = gain * row_time * (rows - neutral rows). Most sensors hold a long frame's length for one, two or three
frames (the gain), but any real gain is met: whole ones are believed until they misfit.
"""

from collections import deque
from dataclasses import dataclass
from itertools import combinations
from math import sqrt
from statistics import median

from capture_app.sync.stamps.robust_slope import SIGMA_FROM_MAD

GAINS = (1.0, 2.0, 3.0)
GAIN_LIMITS = (0.5, 4.0)
REAL_GAIN = 1.2
"""Mean misfit in rows above which a gain that is no whole number is believed."""
MISFIT_ROWS = 20.0
"""A misfit over this counts for no more: an outlier among the timestamps is not the gain's fault."""
APART_ROWS = 10.0
"""Two injections that differ by more rows than this tell a gain."""
USUAL_ROW_NS = 12_000
"""Time of a row where it is not known."""
FINEST_NS = 1_000
"""Step of exposures where the row time is not known."""
USUAL_OVERHEAD_NS = 250_000
"""Time that a frame is longer than its exposure, where nothing is known yet."""
OVERHEAD_SPREAD_NS = 1_000_000
NO_OVERHEAD = 10.0
"""Misfit of an exposure longer than the frame that it does not stretch."""
PROVEN_ROWS = 0.75
"""A whole gain that no injection missed by more is not doubted."""
DOUBT = 0.002
"""Doubt about any other gain, as a share of it."""
FITTING_ROWS = 20.0
"""Doubt about an exposure that fits into a period: it may stretch nothing, and teach next to nothing."""
NEAR_ROWS = 300.0
MISSED_ROWS = 3.0
REMEMBERED = 8


@dataclass(frozen=True, slots=True)
class InjectionProfile:
    """How a device responds to a long frame, kept for its next use."""

    row_time_ns: int
    gain: float
    neutral_rows: float
    """Longest exposure that does not stretch a frame, in rows."""

    def shift_rows(self, rows: float) -> float:
        """By how many rows an exposure of so many delays all frames after it."""
        return max(0.0, self.gain * (rows - self.neutral_rows))


class InjectionHistory:
    """The last injections of one camera: rows exposed, and the rows that the phase moved by."""

    def __init__(self, *, period_ns: int, row_time_ns: int | None) -> None:
        self.row_ns = row_time_ns or FINEST_NS
        """What exposures are counted in."""
        self.row_known = row_time_ns is not None
        self._grain = 1.0 if self.row_known else USUAL_ROW_NS / self.row_ns
        """The sensor's own rows in those that exposures are counted in, or the stamps' noise if larger."""
        self._period_rows = period_ns / self.row_ns
        self._seen: deque[tuple[int, float]] = deque(maxlen=REMEMBERED)

    @property
    def moved(self) -> bool:
        """Whether any injection moved the phase: only then there is something to fit."""
        return any(shift for _, shift in self._seen)

    @property
    def idle_rows(self) -> int:
        """Longest exposure that moved nothing, 0 where there was none."""
        return max((rows for rows, shift in self._seen if not shift), default=0)

    def add(self, rows: int, shift_rows: float, noise_rows: float) -> None:
        """Remember an injection; what the noise of its frames' timestamps explains is no misfit."""
        self._grain = max(self._grain, noise_rows)
        self._seen.append((rows, shift_rows))

    def miss_rows(self, profile: InjectionProfile, rows: int, shift_rows: float) -> float:
        """How far a shift was from what a profile says, in the sensor's own rows."""
        return abs(shift_rows - profile.shift_rows(rows)) / self._grain

    def scatter_ns(self, profile: InjectionProfile) -> float:
        """Standard deviation of what injections did about what a profile says; 0 until it shows."""
        misses = [self.miss_rows(profile, *one) for one in self._seen if one[1]]
        if len(misses) < 2:
            return 0.0
        return (
            SIGMA_FROM_MAD
            * median(misses)
            * sqrt(len(misses) / (len(misses) - 1))
            * self._grain
            * self.row_ns
        )

    def neutral_near(self, profile: InjectionProfile, shift_rows: float) -> float:
        """Neutral rows by the injection that moved the phase most nearly so far, if it fits the profile.

        Where rows or gain are not exact, a line is better near its points than elsewhere.
        """
        near = [
            (abs(shift - shift_rows), rows - shift / profile.gain)
            for rows, shift in self._seen
            if shift and self.miss_rows(profile, rows, shift) < MISSED_ROWS
        ]
        distance, neutral_rows = min(near, default=(0.0, profile.neutral_rows))
        exact = self.row_known and profile.gain in GAINS
        return profile.neutral_rows if exact or distance > NEAR_ROWS * self._grain else neutral_rows

    def doubt_rows(self, profile: InjectionProfile, rows: int) -> float:
        """How far the profile may lead astray, away from the exposures that it was learned from."""
        seen = self._seen
        if not seen:
            return 0.0
        proven = profile.gain in GAINS and all(self.miss_rows(profile, *one) < PROVEN_ROWS for one in seen)
        doubt_rows = 0.0 if proven else DOUBT * profile.gain * min(abs(rows - one) for one, _ in seen)
        if rows < self._period_rows and not (proven and len(seen) > 1):
            doubt_rows += FITTING_ROWS * self._grain
        return doubt_rows

    def fit(self) -> InjectionProfile:
        """The gain whose line fits best, with the overhead it implies as a tie-breaker.

        A real gain is that of an injection with the usual overhead, or what two injections tell.
        """
        idle = (self._period_rows - USUAL_OVERHEAD_NS / self.row_ns, 0.0)
        gains = [
            (shift - other) / (rows - base)
            for (base, other), (rows, shift) in combinations([idle, *self._seen], 2)
            if abs(rows - base) > APART_ROWS * self._grain
        ]
        real = [(gain, REAL_GAIN) for gain in gains if GAIN_LIMITS[0] <= gain <= GAIN_LIMITS[1]]
        fits = [self._fit_gain(gain, penalty) for gain, penalty in [*((g, 0.0) for g in GAINS), *real]]
        return min(fits, key=lambda fit: fit[0])[1]

    def _fit_gain(self, gain: float, penalty: float) -> tuple[float, InjectionProfile]:
        """The misfit of a gain, in rows, and the profile that it makes of the injections seen."""
        neutral = median([rows - shift / gain for rows, shift in self._seen if shift])
        if self.row_known and not penalty:
            neutral = float(round(neutral))
        profile = InjectionProfile(self.row_ns, gain, neutral)
        misses = [self.miss_rows(profile, *one) for one in self._seen]
        misfit = penalty + sum(min(miss, MISFIT_ROWS) for miss in misses) / len(misses)
        overhead_ns = (self._period_rows - neutral) * self.row_ns
        misfit += abs(overhead_ns - USUAL_OVERHEAD_NS) / OVERHEAD_SPREAD_NS
        if overhead_ns < -2.0 * self._grain * self.row_ns:
            misfit += NO_OVERHEAD
        return misfit, profile
