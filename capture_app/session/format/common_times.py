"""Whether the cameras' times of a recording are of one clock, and what was done to make them so."""

import math
from typing import Annotated, Literal

from msgspec import Meta, Struct

from capture_app.common.bounds import Count
from capture_app.common.names import Name

NOT_SYNCHRONIZED = "not synchronized, offsets unknown"
"""What is said of a recording without common times, everywhere."""

ROUGH_FRAMES = 1.5
"""An alignment whose 95 % error is more frames than this does not say which pictures belong together."""

REFERENCE = "reference"
"""The source of the camera whose times all others are brought to."""


TimesState = Literal["unknown", "given", "recorded", "aligned"]
"""How the times of a recording's cameras go together.

unknown    each camera has times of its own, with unknown offsets between them
given      stated at import, by a frame rate, a shift or an uncertainty
recorded   the recording has times of one clock: a table, or a phone's metadata
aligned    measured after it was recorded; see the cameras
"""


class CameraTimes(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """How a camera's own times become the recording's: leader = local + offset + rate * (local - epoch).

    `uncertainty_ns` and `rate_uncertainty_ppm` are 95 % errors, against the reference; the former is at the
    epoch, where the error of the rate has no part in it. What is not known is None, and `reason` says why.
    """

    offset_ns: int | None = None
    uncertainty_ns: Count | None = None
    rate_ppm: float = 0.0
    rate_uncertainty_ppm: Annotated[float, Meta(ge=0)] | None = None
    epoch_local_ns: int = 0
    source: str = ""
    """What it was measured by: sound, flash, gopro (GPS), timecode, motion, or reference."""
    reason: str = ""

    def leader_from_local(self, local_ns: int) -> int:
        """The recording's time in ns of a camera's own; its own time where the offset is not known."""
        if self.offset_ns is None:
            return local_ns
        return local_ns + self.offset_ns + round(self.rate_ppm * 1e-6 * (local_ns - self.epoch_local_ns))

    def uncertainty_at_ns(self, local_ns: int) -> int | None:
        """The 95 % error of `leader_from_local` there."""
        if self.uncertainty_ns is None:
            return None
        drift_ns = (self.rate_uncertainty_ppm or 0.0) * 1e-6 * (local_ns - self.epoch_local_ns)
        return round(math.hypot(self.uncertainty_ns, drift_ns))


class CommonTimes(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The state of a recording's times, and each camera's offset and rate where they were aligned."""

    state: TimesState
    reason: str = ""
    """What the state rests on."""
    reference: str = ""
    """The camera whose own times the recording's are."""
    cameras: dict[Name, CameraTimes] = {}

    @property
    def unknown(self) -> bool:
        """Whether the time offsets between the cameras are unknown."""
        return self.state == "unknown"

    @property
    def words(self) -> str:
        """The state in a short sentence without a full stop."""
        words = {
            "unknown": NOT_SYNCHRONIZED,
            "given": "times taken as common as given",
            "recorded": "common times recorded",
            "aligned": "aligned after recording",
        }[self.state]
        return f"{words}: {self.reason}" if self.reason else words

    def why_not_synchronized(self, period_ns: int) -> str:
        """Why pictures are not called synchronized: offsets unknown, or to some frames only; else empty."""
        if self.unknown:
            return self.words
        worst_ns = max((of.uncertainty_ns or 0 for of in self.cameras.values()), default=0)
        if worst_ns <= ROUGH_FRAMES * period_ns:
            return ""
        return f"not synchronized, offsets known to ± {worst_ns / 1e6:.0f} ms only: {self.reason}"
