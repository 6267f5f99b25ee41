"""Host times for a device counter that cannot be read, from the arrivals of what the counter stamps."""

from math import hypot, log, sqrt

from capture_app.sync.clock.likely_line import DRIFT, MAX_SKEW, ODD_HOSTS, SKEW, LikelyLine

_BLOCK_NS, _BLOCKS = 1_000_000_000, 20
_STEP = 1e-6


class ArrivalClock:
    """Clock estimate from minimum delays of stamped arrivals, averaged over candidate rates by likelihood.

    Nothing arrives before it is stamped, so the smallest delays define the line. Host times are late by the
    minimum delay from stamp to arrival, which stays unknown. Delays beyond it are modelled as exponential
    (Moon et al. 1999 take the likeliest line alone).
    """

    def __init__(self) -> None:
        self._quickest: dict[int, tuple[int, int]] = {}
        """Stamp with the smallest delay and that delay, by second of the counter."""
        self._origin_ns = self._delay_ns = self._last_delay_ns = 0
        self._line: LikelyLine | None = None
        self.jitter_ns = 0.0
        """Mean distance of each second's smallest delay from the line, at the last fit."""
        self.typical_excess_ns = 0.0
        """Mean delay beyond the minimum, if known from elsewhere: a few arrivals do not show it."""

    def add_arrival(self, counter_ns: int, arrival_ns: int) -> None:
        """Add an arrival: the counter's stamp, and the host's time at which it arrived."""
        block, delay_ns = counter_ns // _BLOCK_NS, arrival_ns - counter_ns
        if abs(delay_ns - self._last_delay_ns) > 1_000_000_000:
            self._quickest.clear()  # the counter was set
        self._last_delay_ns = delay_ns
        if block not in self._quickest or delay_ns < self._quickest[block][1]:
            self._quickest[block] = counter_ns, delay_ns
            for old in sorted(self._quickest)[:-_BLOCKS]:
                del self._quickest[old]
            self._line = None

    def host_ns(self, counter_ns: int) -> int | None:
        """Return the host's time of a counter reading; None before the first arrival."""
        if not self._quickest:
            return None
        line = self._fitted()
        return counter_ns + self._delay_ns + round(line.offset + line.skew * (counter_ns - self._origin_ns))

    def uncertainty_ns(self, counter_ns: int) -> int:
        """Return the 95 % error of `host_ns`, without the unknown minimum delay."""
        elapsed_ns = float(counter_ns - self._origin_ns)
        span_ns = float(self._origin_ns - min(self._quickest) * _BLOCK_NS) + abs(elapsed_ns)
        return round(1.96 * hypot(sqrt(self._fitted().variance_at(elapsed_ns)), DRIFT * span_ns**2 / 4.0))

    def _fitted(self) -> LikelyLine:
        if self._line is None:
            points = list(self._quickest.values())
            self._origin_ns, self._delay_ns = max(points)
            self._line = self._fit(points)
        return self._line

    def _fit(self, points: list[tuple[int, int]]) -> LikelyLine:
        import numpy as np

        at = np.array([float(counter - self._origin_ns) for counter, _ in points])
        late = np.array([float(delay - self._delay_ns) for _, delay in points])
        skews = np.arange(-MAX_SKEW, MAX_SKEW + _STEP / 2, _STEP)
        beyond = late - skews[:, None] * at
        levels = beyond.min(axis=1)
        excess = beyond.sum(axis=1) - len(points) * levels
        # The median, because a second that has just begun may have no small delay yet.
        self.jitter_ns = float((np.median(beyond, axis=1) - levels).min()) / log(2.0)
        mean_ns = max(self.jitter_ns, self.typical_excess_ns, 1.0)
        logs = np.log(np.exp(-0.5 * (skews / SKEW) ** 2) + ODD_HOSTS) - excess / mean_ns
        votes = np.exp(logs - logs.max())
        votes /= votes.sum()
        level, skew = float(votes @ levels), float(votes @ skews)
        min_ns = mean_ns / len(points)
        return LikelyLine(
            offset=level - min_ns,
            skew=skew,
            variance=float(votes @ (levels - level) ** 2),
            covariance=float(votes @ ((levels - level) * (skews - skew))),
            skew_variance=float(votes @ (skews - skew) ** 2),
            gap=0.0,
            excess=min_ns**2,
        )
