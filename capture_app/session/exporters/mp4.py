"""MP4: a video of each camera, its frames at the leader's times to a microsecond."""

from pathlib import Path

from capture_app.session.exporters.common.exported_burst import ExportedBurst, ExportOptions
from capture_app.session.exporters.common.tables import write_frames
from capture_app.session.exporters.common.videos import write_timeline


def write(burst: ExportedBurst, folder: Path, options: ExportOptions) -> list[str]:
    """Write <camera>.mp4 for each camera; all count from the burst's earliest image."""
    frames = []
    for camera in burst.cameras:
        file = f"{camera}.mp4"
        frames += write_timeline(burst, camera, folder / file, file, options)
    write_frames(burst, folder, frames)
    return []
