"""MP4: a video of each camera, its frames at the leader's times to a microsecond."""

from pathlib import Path

from capture_app.session.exporters.common.exported_burst import ExportedBurst
from capture_app.session.exporters.common.videos import at_own_times, write_camera


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write <camera>.mp4 for each camera; all count from the burst's earliest image."""
    for camera in burst.cameras:
        write_camera(burst, folder / f"{camera}.mp4", at_own_times(burst, camera), camera)
