"""Options of an import: recording, times, alignment, calibration, and which instants are written."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from capture_app.companions.importing.times.tables import Table
from capture_app.session.importing.calibrations import Fit

TimeSource = Literal["auto", "video", "name", "exif"]
"""Source of a recording's times.

auto    chosen by what the recording has: a table, a phone's metadata
video   from the videos' own timestamps, which may be irregular
name    from the images' file names
exif    from the images' EXIF: capture time with fraction of a second
"""


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """All options of an import."""

    recording: str | None = None
    """Name of one recording, if a program's folder has several."""
    png: bool = False
    """Store a video's frames as PNG instead of JPEG (quality 95)."""
    split: str | None = None
    """`side-by-side` if each picture holds a left and a right view, as stereo cameras write them."""
    fps: float | None = None
    """Frame rate, frames/s."""
    timestamps: Sequence[Table] = ()
    times: TimeSource = "auto"
    synchronized: bool = False
    """Whether frames of equal number belong to one instant; without a rate, videos use their own."""
    offsets_ms: Mapping[str, float] = field(default_factory=dict)
    """Offset that converts a camera's own times to the rig's, ms, by camera name."""
    uncertainty_ms: float | None = None
    """95 % uncertainty of the times."""
    align: str = "auto"
    """Method that aligns a recording without common times: a method's name, none, motion, or auto."""
    sound_distance_m: float = 1.0
    """Maximum difference between the cameras' distances to a sound, m."""
    sound_delay_ms: float = 20.0
    """Maximum difference between two cameras' delays from image to sound, ms (95 %); assumed."""
    calibration: Sequence[str] = ()
    """PATH or NAME=PATH, see `read_views`."""
    unit: str | None = None
    fit: Fit = "exact"
    start: int = 0
    """First instant to import, counted from 0."""
    count: int | None = None
    every: int = 1
    note: str = ""

    @property
    def states_times(self) -> bool:
        """Whether the user specified the source of the times."""
        return self.synchronized or self.fps is not None or bool(self.timestamps) or self.times != "auto"

    @property
    def sound_error_s(self) -> float:
        """Possible offset between two cameras' sounds while their images are simultaneous, s (95 %)."""
        return self.sound_distance_m / 343.0 + self.sound_delay_ms / 1000
