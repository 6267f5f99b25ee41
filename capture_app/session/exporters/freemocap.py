"""FreeMoCap: a recording folder of synchronized videos, and the calibration as its Anipose writes it."""

from pathlib import Path

from capture_app.session.exporters.common.exported_burst import ExportedBurst, ExportOptions
from capture_app.session.exporters.common.tables import camera_tables, unit_note
from capture_app.session.exporters.common.videos import write_paired_videos


def write(burst: ExportedBurst, folder: Path, options: ExportOptions) -> list[str]:
    """Write synchronized_videos/<camera>.mp4, as many frames each, and NAME_camera_calibration.toml.

    FreeMoCap pairs videos and cameras by the order of their names and counts in millimetres.
    """
    names, notes = write_paired_videos(burst, folder, "synchronized_videos")
    if burst.session.calibration() is None:
        return [*notes, "the session has no calibration: calibrate in FreeMoCap"]
    calibration = burst.calibration("FreeMoCap")
    text = camera_tables(calibration, names, "mm")
    (folder / f"{burst.name}_camera_calibration.toml").write_text(text, encoding="utf-8")
    return notes + unit_note(calibration, "mm")
