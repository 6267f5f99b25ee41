"""All options of an import, by the stage that reads them."""

from dataclasses import dataclass

from capture_app.session.importing.aligning import AlignmentOptions
from capture_app.session.importing.calibrations import ViewOptions
from capture_app.session.importing.times.rules import TimeOptions


@dataclass(frozen=True, kw_only=True)
class ImportOptions(TimeOptions, AlignmentOptions, ViewOptions):
    """All options of an import: also which instants of which recording are written, and how."""

    start: int = 0
    """First instant to import, counted from 0."""
    count: int | None = None
    every: int = 1
    png: bool = False
    """Store a video's frames as PNG instead of JPEG (quality 95)."""
    note: str = ""
    recording: str | None = None
    """Name of one recording, if a program's folder has several."""
