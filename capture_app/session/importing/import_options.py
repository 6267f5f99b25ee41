"""User's options for an import: times, instants, and calibration of the recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from capture_app.session.importing.aligning import AlignBy
from capture_app.session.importing.calibrations import Fit
from capture_app.session.importing.embedded_times import TimeSource
from capture_app.session.importing.frame_matching import Timeline

SOUND_DISTANCE_M = 1.0
SOUND_DELAY_MS = 20.0
"""Assumed: there is no measurement of the cameras' sound delay."""


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """Options of an import: frame rate in frames/s or a table of times, and which instants to import."""

    fps: float | None = None
    timestamps: Path | None = None
    times: TimeSource = "auto"
    offsets_ms: Mapping[str, float] = field(default_factory=dict)
    """Offset that converts a camera's own times to the rig's, ms, by camera name."""
    synchronized: bool = False
    """Whether frames of equal number belong to one instant; without a rate, videos use their own."""
    uncertainty_ms: float | None = None
    """95 % uncertainty of the times, stated by the user."""
    known: Timeline | None = None
    """Times written by the program that made the recording."""
    start: int = 0
    """First instant to import, counted from 0."""
    count: int | None = None
    every: int = 1
    png: bool = False
    """Store a video's frames as PNG instead of JPEG (quality 95)."""
    align: AlignBy = "auto"
    """Method that aligns a recording without common times."""
    sound_distance_m: float = SOUND_DISTANCE_M
    """Maximum difference between the cameras' distances to a sound, m."""
    sound_delay_ms: float = SOUND_DELAY_MS
    """Maximum difference between two cameras' delays from image to sound, ms (95 %)."""
    calibration: Sequence[str] = field(default_factory=tuple)
    """PATH or NAME=PATH, see `read_views`."""
    beside: Path | None = None
    """A calibration found beside the recording, used if it fits."""
    unit: str | None = None
    fit: Fit = "exact"
    note: str = ""
    recording: str | None = None
    """Name of one recording, if a program's folder has several."""

    @property
    def report_times(self) -> bool:
        """Whether the user specified the source of the times."""
        return self.fps is not None or self.timestamps is not None or self.times != "auto"
