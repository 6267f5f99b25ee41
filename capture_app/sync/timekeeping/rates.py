"""Detection of clocks at an unusual rate: one node against its leader, and a majority vote of all hosts."""

from collections.abc import Mapping
from dataclasses import dataclass

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.timekeeping.clock_events import ClockChanged, ClockRateUnusual

TYPICAL_PPM = 100.0
"""Maximum rate difference of two ordinary crystals."""
STILL_UNUSUAL_PPM = 80.0
"""Threshold below which an unusual rate counts as ordinary again."""
JUDGED_AFTER_NS = 5_000_000_000
"""Time from the first estimate until a rate is judged: before, changes of a WiFi path look like one."""
RECENT_NS = 30_000_000_000
"""Time for which a rate change is reported: as long as samples from before it affect the estimate."""
LEADER = None
"""Stands in for a node's name: the leader's own host."""


class RateWatch:
    """Rate check of a node's clock against the leader's; `now_ns` is the node's own clock."""

    def __init__(self) -> None:
        self.fast_ppm: float | None = None
        """Rate excess of this node's clock over the leader's; None if it is ordinary."""
        self._changed_ns: int | None = None
        self._began_ns: int | None = None

    def restart(self) -> None:
        """Clear the verdict: the leader is another one, or a clock has stepped."""
        self.fast_ppm = self._began_ns = None

    def judge(self, time_map: TimeMap, changed_ns: int | None) -> ClockRateUnusual | ClockChanged | None:
        """Judge the rate of this node's clock by the newest estimate; return an event if something changed.

        `changed_ns` is the time of the last rate change. An event reports a new change, or that the rate has
        become unusual or typical again.
        """
        # The map is from this clock to the leader's: a positive skew means that the leader's is faster.
        fast_ppm, uncertainty_ppm = -time_map.skew * 1e6, time_map.skew_uncertainty * 1e6
        min_ppm = TYPICAL_PPM + uncertainty_ppm if self.fast_ppm is None else STILL_UNUSUAL_PPM
        if self._began_ns is None:
            self._began_ns = time_map.epoch_local_ns
        is_known = time_map.epoch_local_ns - self._began_ns >= JUDGED_AFTER_NS
        before, self.fast_ppm = self.fast_ppm, fast_ppm if is_known and abs(fast_ppm) > min_ppm else None
        if changed_ns not in (None, self._changed_ns):
            self._changed_ns = changed_ns
            return ClockChanged(jumped=False)
        return None if (before is None) is (self.fast_ppm is None) else ClockRateUnusual(self.fast_ppm)

    def changed_lately(self, now_ns: int) -> bool:
        """Whether the rate of one of the two clocks has changed within RECENT_NS."""
        return self._changed_ns is not None and now_ns - self._changed_ns < RECENT_NS


@dataclass(frozen=True, slots=True)
class HostOffRate:
    """A host whose clock rate differs from the majority's."""

    name: str | None
    """Name of the node; None for the leader."""
    fast_ppm: float
    """Rate excess over the majority; 0 if it is ordinary again or removed."""
    ambiguous: bool = False
    """Whether there is no majority, so that the leader's clock may be the unusual one."""


class RateVote:
    """Hosts with an unusual clock rate; rates in ppm relative to the leader's clock, positive if faster."""

    def __init__(self) -> None:
        self.off: dict[str | None, HostOffRate] = {}
        """Hosts with an unusual rate, by name."""

    def review(self, rates_ppm: Mapping[str, float]) -> list[HostOffRate]:
        """Compare all measured rates of nodes again, and return what changed."""
        rates: dict[str | None, float] = {LEADER: 0.0}
        rates.update(rates_ppm)
        friends = {
            name: sum(abs(rate - other) <= TYPICAL_PPM / 2.0 for other in rates.values())
            for name, rate in rates.items()
        }
        max_count = max(friends.values())
        # In a tie the leader's rate wins, because the leader's clock is the rig's time.
        typical_ppm = rates[next(name for name, count in friends.items() if count == max_count)]
        off = {
            name: HostOffRate(name, rate - typical_ppm, ambiguous=max_count == friends[name])
            for name, rate in rates.items()
            if abs(rate - typical_ppm) > (STILL_UNUSUAL_PPM if name in self.off else TYPICAL_PPM)
        }
        before, self.off = self.off, off
        changes = [off[name] for name in off if name not in before]
        return [*changes, *(HostOffRate(name, 0.0) for name in before if name not in off)]
