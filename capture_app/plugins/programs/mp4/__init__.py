"""MP4: a video of each camera, with the sound of imported recordings."""

from capture_app.plugins.programs.mp4.mp4_writer import EXPORTER

__all__ = ["EXPORTER"]
