"""ROS bags, and .mcap files of ROS or Foxglove messages: each topic of images is a camera."""

from pathlib import Path

from capture_app.plugins.programs.mcap.bags import is_bag, read_bag
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import Layout


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open the cameras of a recording of messages, timed by its own stamps."""
    return read_bag(path)[0] if is_bag(path) else None


IMPORTER = Importer(
    program="ROS, Foxglove",
    help="a rosbag2 folder, a ROS 1 .bag, an .mcap of ROS's or Foxglove's messages",
    open_recording=open_recording,
)
