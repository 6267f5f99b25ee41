"""EasyMocap: videos/<camera>.mp4, intri.yml and extri.yml."""

from pathlib import Path

from capture_app.session.exporting.csv_tables import renaming_notes, write_cameras, yaml_names
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import VIDEOS, Exporter
from capture_app.session.exporting.videos import write_paired_videos


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write videos with equal numbers of frames, and the cameras in metres; pixels are as in OpenCV."""
    names = yaml_names(burst.cameras)
    files = {camera: f"videos/{name}.mp4" for camera, name in names.items()}
    burst.notes += renaming_notes(names)
    write_paired_videos(burst, folder, files)
    write_cameras(folder, burst.required_calibration, names, centre=0.0)


EXPORTER = Exporter(
    write=write,
    help="EasyMocap: videos, intri.yml and extri.yml",
    program="EasyMocap",
    calibration="required",
    unit="m",
    packages=VIDEOS,
)
