"""Which host's clock runs at another rate than the others': what all nodes say of theirs, put together."""

from collections.abc import Mapping
from dataclasses import dataclass

from capture_app.sync.timekeeping.rate_watch import STILL_UNUSUAL_PPM, USUAL_PPM

LEADER = None
"""In the place of a node's name: the leader's own host."""


@dataclass(frozen=True, slots=True)
class HostOffRate:
    """A host's clock runs at another rate than those of the others, or the host says that it slews it."""

    name: str | None
    """The node's; None for the leader."""
    fast_ppm: float
    """By how much it is faster than the others, or than usual."""
    certain: bool
    """Whether the host says so itself."""
    ambiguous: bool
    """Whether there is no majority: it may as well be the leader's clock."""


@dataclass(frozen=True, slots=True)
class HostAtRate:
    """A host's clock runs at the rate of the others again, or the host is gone."""

    name: str | None


class RateJury:
    """Keeps who is off rate; rates are relative to the leader's clock, in ppm, positive where faster."""

    def __init__(self) -> None:
        self.off: dict[str | None, HostOffRate] = {}
        """The hosts that are off rate, by name."""

    def review(
        self, rates_ppm: Mapping[str, float], slewing_ppm: Mapping[str | None, float]
    ) -> list[HostOffRate | HostAtRate]:
        """Judge all anew, and return what is news.

        `rates_ppm` are those of the nodes, `slewing_ppm` what hosts that can tell say of themselves.
        """
        rates: dict[str | None, float] = {LEADER: 0.0}
        rates.update(rates_ppm)
        friends = {name: self._friends(rate, rates) for name, rate in rates.items()}
        most = max(friends.values())
        # Of equals the leader's is the rate of the rig, being the time that all pictures are stamped in.
        usual_ppm = rates[next(name for name, count in friends.items() if count == most)]
        off: dict[str | None, HostOffRate] = {}
        for name, rate in rates.items():
            fast_ppm, own_ppm = rate - usual_ppm, slewing_ppm.get(name, 0.0)
            if own_ppm:
                off[name] = HostOffRate(name, own_ppm, certain=True, ambiguous=False)
            elif abs(fast_ppm) > (STILL_UNUSUAL_PPM if name in self.off else USUAL_PPM):
                off[name] = HostOffRate(name, fast_ppm, certain=False, ambiguous=most == friends[name])
        before, self.off = self.off, off
        news = [off[name] for name in off if name not in before or before[name].certain != off[name].certain]
        return [*news, *(HostAtRate(name) for name in before if name not in off)]

    def _friends(self, rate: float, rates: Mapping[str | None, float]) -> int:
        return sum(abs(rate - other) <= USUAL_PPM / 2.0 for other in rates.values())
