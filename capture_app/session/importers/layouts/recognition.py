"""Recognizes recording folders of other programs, and our own exports, by their files."""

from pathlib import Path

from capture_app.session.exchange.export_record import RECORD
from capture_app.session.importers.layouts.layout import Layout

MCAP = ".mcap"


def recognize_layout(path: Path, *, png: bool = False, recording: str | None = None) -> Layout | None:
    """The layout of a folder or an .mcap file, or None.

    `recording` names one of several in it; `png` as of `Video`. Raises BadInputError where it has several.
    """
    if path.suffix.lower() == MCAP and path.is_file():
        from capture_app.session.importers.layouts.mcap import mcap

        return mcap(path)
    if not path.is_dir():
        return None
    if (path / RECORD).is_file():
        from capture_app.session.importers.layouts.exported import exported

        return exported(path, png=png)
    from capture_app.session.importers.layouts.caliscope import caliscope
    from capture_app.session.importers.layouts.freemocap import freemocap
    from capture_app.session.importers.layouts.opencap import opencap

    return (
        freemocap(path, png=png)
        or caliscope(path, png=png, recording=recording)
        or opencap(path, png=png, recording=recording)
    )
