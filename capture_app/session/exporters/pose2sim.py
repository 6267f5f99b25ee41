"""Pose2Sim: a trial's folder with its videos and its calibration."""

from pathlib import Path

from capture_app.session.exporters.common.exported_burst import ExportedBurst, ExportOptions
from capture_app.session.exporters.common.tables import camera_tables, paired_names, unit_note, write_frames
from capture_app.session.exporters.common.videos import grid_notes, write_instants


def write(burst: ExportedBurst, folder: Path, options: ExportOptions) -> list[str]:
    """Write videos/<camera>.mp4, as many frames each, and calibration/Calib.toml in metres.

    Pose2Sim pairs videos and cameras by the order of their names.
    """
    calibration = burst.calibration("Pose2Sim")
    (folder / "videos").mkdir()
    (folder / "calibration").mkdir()
    names = paired_names(burst.cameras)
    frames = []
    for camera, name in names.items():
        file = f"videos/{name}.mp4"
        frames += write_instants(burst, camera, folder / file, file)
    write_frames(burst, folder, frames)
    text = camera_tables(calibration, names, "m")
    (folder / "calibration" / "Calib.toml").write_text(text, encoding="utf-8")
    return grid_notes(burst, frames) + unit_note(calibration, "m")
