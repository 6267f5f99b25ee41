"""Clocks whose rate is off: a node sees that its own and the leader's are, a vote of all tells whose."""

from collections.abc import Mapping
from dataclasses import dataclass

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.timekeeping.clock_events import ClockChanged, ClockRateUnusual

USUAL_PPM = 100.0
"""Two ordinary crystals differ by less."""
STILL_UNUSUAL_PPM = 80.0
"""A rate that was called unusual is called so until it is below this."""
RECENT_NS = 30_000_000_000
"""For so long a change of the rate is spoken of: as long as the clock's samples of before it count."""
LEADER = None
"""In the place of a node's name: the leader's own host."""


class RateWatch:
    """Judges a node's clock against the leader's; `now_ns` is the node's own clock."""

    def __init__(self) -> None:
        self.fast_ppm: float | None = None
        """By how much this node's clock runs faster than the leader's, where that is unusual."""
        self.host_slewing_ppm: float | None = None
        """By how much this node's host makes its clock run faster than usual, as the host says itself."""
        self._changed_ns: int | None = None

    def restart(self) -> None:
        """Judge anew: there is another leader, or a clock has stepped."""
        self.fast_ppm = None

    def judge(self, time_map: TimeMap, changed_ns: int | None) -> ClockRateUnusual | ClockChanged | None:
        """Take in the newest estimate and when the rate last changed; return what is news."""
        # The map is from this clock to the leader's: where its skew is positive, the leader's is faster.
        fast_ppm, doubt_ppm = -time_map.skew * 1e6, time_map.skew_uncertainty * 1e6
        least_ppm = USUAL_PPM + doubt_ppm if self.fast_ppm is None else STILL_UNUSUAL_PPM
        before, self.fast_ppm = self.fast_ppm, fast_ppm if abs(fast_ppm) > least_ppm else None
        if changed_ns not in (None, self._changed_ns):
            self._changed_ns = changed_ns
            return ClockChanged(jumped=False)
        return None if (before is None) is (self.fast_ppm is None) else ClockRateUnusual(self.fast_ppm)

    def changed_lately(self, now_ns: int) -> bool:
        """Whether the rate of one of the two clocks has changed a short while ago."""
        return self._changed_ns is not None and now_ns - self._changed_ns < RECENT_NS


@dataclass(frozen=True, slots=True)
class HostOffRate:
    """A host's clock runs at another rate than those of the others, or the host says that it slews it."""

    name: str | None
    """The node's; None for the leader."""
    fast_ppm: float
    """By how much it is faster than the others, or than usual; 0 where it is no more, or the host is gone."""
    certain: bool = False
    """Whether the host says so itself."""
    ambiguous: bool = False
    """Whether there is no majority: it may as well be the leader's clock."""


class RateVote:
    """Keeps who is off rate; rates are relative to the leader's clock, in ppm, positive where faster."""

    def __init__(self) -> None:
        self.off: dict[str | None, HostOffRate] = {}
        """The hosts that are off rate, by name."""

    def review(
        self, rates_ppm: Mapping[str, float], slewing_ppm: Mapping[str | None, float]
    ) -> list[HostOffRate]:
        """Judge all anew, and return what is news.

        `rates_ppm` are those of the nodes, `slewing_ppm` what hosts that can tell say of themselves.
        """
        rates: dict[str | None, float] = {LEADER: 0.0}
        rates.update(rates_ppm)
        friends = {
            name: sum(abs(rate - other) <= USUAL_PPM / 2.0 for other in rates.values())
            for name, rate in rates.items()
        }
        most = max(friends.values())
        # Of equals the leader's is the rate of the rig, being the time that all pictures are stamped in.
        usual_ppm = rates[next(name for name, count in friends.items() if count == most)]
        off: dict[str | None, HostOffRate] = {}
        for name, rate in rates.items():
            fast_ppm, own_ppm = rate - usual_ppm, slewing_ppm.get(name, 0.0)
            if own_ppm:
                off[name] = HostOffRate(name, own_ppm, certain=True)
            elif abs(fast_ppm) > (STILL_UNUSUAL_PPM if name in self.off else USUAL_PPM):
                off[name] = HostOffRate(name, fast_ppm, ambiguous=most == friends[name])
        before, self.off = self.off, off
        news = [off[name] for name in off if name not in before or before[name].certain != off[name].certain]
        return [*news, *(HostOffRate(name, 0.0) for name in before if name not in off)]
