"""From a value to a place on an axis: linear in a band around zero, logarithmic beyond it."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BandScale:
    """An axis from -limit to +limit whose middle share, the band, is linear from -band to +band."""

    band: float
    """Values up to this, either side of zero, are in the band; > 0."""
    limit: float
    """The end of the axis; > band."""
    share: float
    """Of the axis that the band takes, 0 to 1."""

    def place(self, value: float) -> float:
        """Where a value is: 0 for -limit, 0.5 for zero, 1 for +limit; beyond the ends, the end."""
        size = min(abs(value), self.limit)
        half = self.share / 2
        if size <= self.band:
            away = half * size / self.band
        else:
            away = half + (0.5 - half) * math.log(size / self.band) / math.log(self.limit / self.band)
        return 0.5 + math.copysign(away, value)
