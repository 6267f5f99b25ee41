"""A counter of a device that cannot be read, known by when what it stamps arrives here."""

from math import hypot, log, sqrt

from capture_app.sync.clock.likely_line import DRIFT, MAX_SKEW, ODD_HOSTS, SKEW, LikelyLine

_BLOCK_NS, _BLOCKS = 1_000_000_000, 20
_SET_NS = 1_000_000_000
"""Nothing is that much quicker or slower than what came before it."""
_STEP = 1e-6
_SIGMAS = 1.96


class ArrivalClock:
    """Nothing arrives before it is stamped, and the quickest tell the line, each rate as likely as it fits.

    The host's times are late by the least delay from stamp to arrival, whatever that is. Delays beyond that
    are taken to be exponential (Moon et al. 1999 take the likeliest line alone).
    """

    def __init__(self) -> None:
        self._quickest: dict[int, tuple[int, int]] = {}
        """By second of the counter: the stamp that arrived soonest, and its delay."""
        self._origin_ns = self._delay_ns = self._last_delay_ns = 0
        self._line: LikelyLine | None = None
        self.spread_ns = 0.0
        """How far the quickest of each second lie from the line, on average, when it was asked for last."""
        self.usual_excess_ns = 0.0
        """The mean delay beyond the least, where others know it: few arrivals do not tell it."""

    def add_arrival(self, counter_ns: int, arrival_ns: int) -> None:
        """Take in when what has that stamp arrived, by the host's clock."""
        block, delay_ns = counter_ns // _BLOCK_NS, arrival_ns - counter_ns
        if abs(delay_ns - self._last_delay_ns) > _SET_NS:
            self._quickest.clear()  # the counter was set
        self._last_delay_ns = delay_ns
        known = self._quickest.get(block)
        if known is not None and known[1] <= delay_ns:
            return
        self._quickest[block] = counter_ns, delay_ns
        for old in sorted(self._quickest)[:-_BLOCKS]:
            del self._quickest[old]
        self._line = None

    def host_ns(self, counter_ns: int) -> int | None:
        """The host's time of a reading of the counter; None where nothing is known of it yet."""
        if not self._quickest:
            return None
        line = self._fitted()
        return counter_ns + self._delay_ns + round(line.offset + line.skew * (counter_ns - self._origin_ns))

    def uncertainty_ns(self, counter_ns: int) -> int:
        """95 % error of `host_ns`, the least delay left out."""
        away_ns = float(counter_ns - self._origin_ns)
        span_ns = float(self._origin_ns - min(self._quickest) * _BLOCK_NS) + abs(away_ns)
        bend_ns = DRIFT * span_ns**2 / 4.0
        return round(_SIGMAS * hypot(sqrt(self._fitted().variance_at(away_ns)), bend_ns))

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
        # By the median: a second that has just begun may have nothing quick yet.
        self.spread_ns = float((np.median(beyond, axis=1) - levels).min()) / log(2.0)
        mean_ns = max(self.spread_ns, self.usual_excess_ns, 1.0)
        logs = np.log(np.exp(-0.5 * (skews / SKEW) ** 2) + ODD_HOSTS) - excess / mean_ns
        votes = np.exp(logs - logs.max())
        votes /= votes.sum()
        level, skew = float(votes @ levels), float(votes @ skews)
        least_ns = mean_ns / len(points)
        return LikelyLine(
            offset=level - least_ns,
            skew=skew,
            variance=float(votes @ (levels - level) ** 2),
            covariance=float(votes @ ((levels - level) * (skews - skew))),
            skew_variance=float(votes @ (skews - skew) ** 2),
            gap=0.0,
            excess=least_ns**2,
        )
