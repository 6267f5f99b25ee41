"""What a camera is and can do: one struct, which drivers fill in, nodes send and sessions keep."""

from enum import StrEnum
from typing import Annotated

from msgspec import Meta, Struct

Text = Annotated[str, Meta(max_length=200)]
Count = Annotated[int, Meta(ge=0)]
Positive = Annotated[int, Meta(gt=0)]

SIMULATED = "sim"
"""The kind of every simulated camera."""


class TimestampSource(StrEnum):
    """The moment of a frame that the driver stamps."""

    START_OF_EXPOSURE = "start-of-exposure"
    END_OF_FRAME = "end-of-frame"
    UNKNOWN = "unknown"


class PhaseControl(StrEnum):
    """How the phase of a stream can be moved."""

    FRAME_DURATION = "frame-duration"
    INJECTION = "injection"
    RESET = "reset"
    NONE = "none"


class CameraFacts(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """What a camera is and can do, fixed while it streams; times in ns, None where they are not known."""

    kind: Text
    """Its driver, such as v4l2 or sim; imported for a recording; clock or relay where there is no camera."""
    model: Text
    width: Count
    """In pixels, as the height; 0 for a node without a camera."""
    height: Count
    period_ns: Positive
    timestamp_source: TimestampSource
    phase_control: PhaseControl
    pixel_format: Text = ""
    """How the driver delivers pictures, such as MJPG; empty where it is not known."""
    row_time_ns: Count | None = None
    """Readout time of one row."""
    exposure_ns: Count | None = None
    min_exposure_ns: Count | None = None
    max_exposure_ns: Count | None = None
    min_frame_duration_ns: Count | None = None
    max_frame_duration_ns: Count | None = None
    """Shortest and longest time that one frame can last, where the duration of each can be set."""

    def exposure_start_ns(self, stamp_ns: int, exposure_ns: int | None) -> int | None:
        """When the exposure of a frame's first row begins, by the clock of the frame's stamp.

        A stamp at the end of the frame is later by the exposure and the readout of all rows but the first.
        None where the stamp's moment, or what would be taken off it, is not known.
        """
        if self.timestamp_source is TimestampSource.START_OF_EXPOSURE:
            return stamp_ns
        known = self.timestamp_source is TimestampSource.END_OF_FRAME
        if not known or exposure_ns is None or self.row_time_ns is None:
            return None
        return stamp_ns - exposure_ns - (self.height - 1) * self.row_time_ns

    def mid_exposure_offset_ns(self, height_share: float) -> int | None:
        """Time from a frame's stamp to the middle of a row's exposure; the row at that share of the height.

        None where the camera's rows or exposure, or the stamp's moment, is not known.
        """
        start_ns = self.exposure_start_ns(0, self.exposure_ns)
        if start_ns is None or self.exposure_ns is None or self.row_time_ns is None:
            return None
        return start_ns + round(height_share * (self.height - 1)) * self.row_time_ns + self.exposure_ns // 2
