"""What a user says of a recording that is imported: its times, which instants, and its calibration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from capture_app.session.importing.aligning import AlignBy
from capture_app.session.importing.calibrations import Fit
from capture_app.session.importing.embedded_times import TimeSource
from capture_app.session.importing.frame_matching import Timeline

SOUND_DISTANCE_M = 1.0
SOUND_DELAY_MS = 20.0
"""Assumed: nobody has measured how late cameras' sound is."""


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """How a recording is read: its rate in frames a second or its table of times, and what is taken of it."""

    fps: float | None = None
    timestamps: Path | None = None
    times: TimeSource = "auto"
    offsets_ms: Mapping[str, float] = field(default_factory=dict)
    """What is added to a camera's own times to get the rig's, by the camera's name."""
    synchronized: bool = False
    """Frames of the same number are of one instant; of videos without a rate given, at their own."""
    uncertainty_ms: float | None = None
    """The 95 % error of the times, as the user says."""
    known: Timeline | None = None
    """The times that the recording's program wrote."""
    start: int = 0
    """The first instant that is taken, counted from 0."""
    count: int | None = None
    every: int = 1
    png: bool = False
    """Keep a video's frames as PNG instead of JPEG (quality 95)."""
    align: AlignBy = "auto"
    """What a recording without common times is aligned by."""
    sound_distance_m: float = SOUND_DISTANCE_M
    """How much farther one camera may be from what sounds than another."""
    sound_delay_ms: float = SOUND_DELAY_MS
    """How much later one camera's sound may be than its pictures, against another's (95 %)."""
    calibration: Sequence[str] = field(default_factory=tuple)
    """PATH or NAME=PATH, see `read_views`."""
    beside: Path | None = None
    """A calibration that lies beside the recording: taken where it fits."""
    unit: str | None = None
    fit: Fit = "exact"
    note: str = ""
    recording: str | None = None
    """Which of several recordings in a program's folder."""

    @property
    def tell_times(self) -> bool:
        """Whether the user says where the times come from."""
        return self.fps is not None or self.timestamps is not None or self.times != "auto"
