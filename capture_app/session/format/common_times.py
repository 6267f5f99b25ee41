"""Common times of a recording's cameras: whether their times share a clock, and how they were aligned."""

import math
from typing import Annotated, Literal

from msgspec import Meta, Struct

from capture_app.common.bounds import Count, Real, TimeNs
from capture_app.common.names import Name

NOT_SYNCHRONIZED = "not synchronized, offsets unknown"
"""Text for a recording without common times, in all messages."""

ROUGH_FRAMES = 1.5
"""Frame periods; an alignment with a larger 95 % error does not determine which images belong together."""

REFERENCE = "reference"
"""`source` of the camera to whose times all others are converted."""


TimesState = Literal["unknown", "given", "recorded", "aligned"]
"""Relation between the times of a recording's cameras.

unknown    each camera has times of its own, with unknown offsets between them
given      stated at import, by a frame rate, a shift or an uncertainty
recorded   the recording has times of one clock: a table, or a phone's metadata
aligned    measured after it was recorded; see the cameras
"""


class CameraTimes(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Conversion of a camera's own time to the recording's: leader = local + offset + rate * (local - epoch).

    `uncertainty_ns` and `rate_uncertainty_ppm` are 95 % errors against the reference camera; the former holds
    at the epoch, where the rate's error does not count. Unknown values are None, with the `reason`.
    """

    offset_ns: TimeNs | None = None
    uncertainty_ns: Count | None = None
    rate_ppm: Real = 0.0
    rate_uncertainty_ppm: Annotated[float, Meta(ge=0, lt=1e15)] | None = None
    epoch_local_ns: TimeNs = 0
    source: str = ""
    """Method of the measurement: sound, flash, gopro (GPS), timecode or motion; `reference` for none."""
    reason: str = ""

    def leader_from_local(self, local_ns: int) -> int:
        """Convert a camera's own time to the recording's, ns; return it unchanged if that is unknown."""
        drift_ns = round(self.rate_ppm * 1e-6 * (local_ns - self.epoch_local_ns))
        return local_ns if self.offset_ns is None else local_ns + self.offset_ns + drift_ns

    def uncertainty_at_ns(self, local_ns: int) -> int | None:
        """Return the 95 % error of `leader_from_local` at a camera's own time, ns; None if unknown."""
        if self.uncertainty_ns is None:
            return None
        drift_ns = (self.rate_uncertainty_ppm or 0.0) * 1e-6 * (local_ns - self.epoch_local_ns)
        return round(math.hypot(self.uncertainty_ns, drift_ns))


class CommonTimes(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """State of a recording's times and, if they were aligned, the offset and rate of each camera."""

    state: TimesState
    reason: str = ""
    """Reason for the state, for people."""
    reference: str = ""
    """Camera whose own times are the recording's."""
    cameras: dict[Name, CameraTimes] = {}

    @property
    def unknown(self) -> bool:
        """Whether the time offsets between the cameras are unknown."""
        return self.state == "unknown"

    @property
    def methods(self) -> str:
        """The methods that aligned its cameras, in words: "sound, motion"; empty if none did."""
        return ", ".join(
            dict.fromkeys(camera.source for camera in self.cameras.values() if camera.source != REFERENCE)
        )

    @property
    def words(self) -> str:
        """The state as a short sentence for people, without a full stop."""
        words = {
            "unknown": NOT_SYNCHRONIZED,
            "given": "times taken as common as given",
            "recorded": "common times recorded",
            "aligned": "aligned after recording",
        }[self.state]
        return f"{words}: {self.reason}" if self.reason else words

    def why_not_synchronized(self, period_ns: int) -> str:
        """Return why images do not count as synchronized: offsets unknown or too uncertain; empty if they do.

        `period_ns` is the frame period.
        """
        if self.unknown:
            return self.words
        worst_ns = max((camera.uncertainty_ns or 0 for camera in self.cameras.values()), default=0)
        rough = f"not synchronized, offsets known to ± {worst_ns / 1e6:.0f} ms only: {self.reason}"
        return rough if worst_ns > ROUGH_FRAMES * period_ns else ""
