"""Pose2Sim: a trial's folder with its videos and its calibration."""

from pathlib import Path

from capture_app.session.exporting.csv_tables import camera_tables, paired_names
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import VIDEOS, Exporter
from capture_app.session.exporting.videos import write_paired_videos


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write videos/<camera>.mp4 with equal numbers of frames, and calibration/Calib.toml in metres.

    Pose2Sim pairs videos and cameras by the order of their names.
    """
    names = paired_names(burst.cameras)
    files = {camera: f"videos/{name}.mp4" for camera, name in names.items()}
    write_paired_videos(burst, folder, files)
    table = folder / "calibration" / "Calib.toml"
    table.parent.mkdir()
    table.write_text(camera_tables(burst.required_calibration, names, "m"), encoding="utf-8")


EXPORTER = Exporter(
    write=write,
    help="a trial: videos and calibration/Calib.toml",
    program="Pose2Sim",
    calibration="required",
    unit="m",
    packages=VIDEOS,
)
