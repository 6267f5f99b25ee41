"""Which moment of a frame a V4L2 driver stamps, and by which clock."""

import time

from capture_app.camera_facts import TimestampSource
from capture_app.cameras.v4l2 import layout as v4l2
from capture_app.errors import CameraError

_FOREIGN_CLOCK_NS = 60_000_000_000
"""A stamp this far from now is not of this process's monotonic clock."""
_SOURCES = {
    v4l2.BUF_FLAG_SOURCE_START_OF_EXPOSURE: TimestampSource.START_OF_EXPOSURE,
    v4l2.BUF_FLAG_SOURCE_END_OF_FRAME: TimestampSource.END_OF_FRAME,
}


def is_monotonic(timestamp_ns: int) -> bool:
    """Whether a stamp of a frame that has just come can be of this process's monotonic clock."""
    return abs(timestamp_ns - time.monotonic_ns()) <= _FOREIGN_CLOCK_NS


def timestamp_source(path: str, flags: int) -> TimestampSource:
    """The moment that a driver's buffers are stamped at. Raises CameraError for another clock."""
    if flags & v4l2.BUF_FLAG_TIMESTAMP_MASK != v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC:
        raise foreign_clock(path)
    return _SOURCES.get(flags & v4l2.BUF_FLAG_SOURCE_MASK, TimestampSource.UNKNOWN)


def foreign_clock(path: str) -> CameraError:
    """The error of a device that stamps its frames in another clock."""
    return CameraError(
        f"{path} does not stamp its frames in this machine's monotonic clock",
        hint="for a USB camera: echo CLOCK_MONOTONIC | sudo tee /sys/module/uvcvideo/parameters/clock",
    )
