"""What a program's folder holds, in one form for all programs."""

from dataclasses import dataclass
from pathlib import Path

from capture_app.session.exchange.export_record import ExportRecord
from capture_app.session.importers.calibrations.camera_views import Views
from capture_app.session.importers.frame_matching import Timeline
from capture_app.session.importers.sources import Source


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The cameras in a program's folder, and its times and calibration where it has them."""

    program: str
    path: Path
    """Where the cameras are."""
    sources: tuple[Source, ...]
    timeline: Timeline | None = None
    """The times that the program wrote."""
    timestamps: Path | None = None
    """A table with them."""
    same_frames: bool = False
    """Frames of the same number are of one instant, at the videos' own rate."""
    calibration: Path | None = None
    views: Views | None = None
    """The calibration, where it is in the recording itself."""
    unit: str | None = None
    record: ExportRecord | None = None
    """Of our own exports: the session that it was made of."""
    remark: str = ""
    """What the user should know."""
