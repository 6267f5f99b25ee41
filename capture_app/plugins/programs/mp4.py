"""MP4: a video of each camera, with frames at the leader's times to a microsecond."""

from pathlib import Path

from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import VIDEOS, Exporter
from capture_app.session.exporting.videos import at_own_times, write_camera


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write <camera>.mp4 for each camera; all start at the burst's earliest image."""
    for camera in burst.cameras:
        write_camera(burst, folder / f"{camera}.mp4", at_own_times(burst, camera), camera)


EXPORTER = Exporter(
    write=write,
    help="a video of each camera with its exact timestamps",
    program="MP4",
    packages=VIDEOS,
)
