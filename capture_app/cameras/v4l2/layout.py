"""The structs and constants of <linux/videodev2.h> as 64-bit little-endian kernels lay them out."""

import struct
from dataclasses import dataclass
from fractions import Fraction

CAPABILITY = struct.Struct("<16s32s32sIII12x")
FORMAT_DESCRIPTION = struct.Struct("<III32s4s16x")
FRAME_SIZE = struct.Struct("<I4sI6I8x")
FRAME_INTERVAL = struct.Struct("<I4sIII6I8x")
FORMAT = struct.Struct("<I4xII4sIII176x")
STREAM_PARAMETERS = struct.Struct("<IIIII184x")
REQUEST_BUFFERS = struct.Struct("<III8x")
BUFFER = struct.Struct("<5I4xqq16xIII4xI12x")
QUERY_CONTROL = struct.Struct("<II32siiiiI8x")
CONTROL = struct.Struct("<Ii")
STREAM_TYPE = struct.Struct("<i")

_READ, _WRITE = 2, 1


def _request(direction: int, number: int, layout: struct.Struct) -> int:
    return direction << 30 | layout.size << 16 | ord("V") << 8 | number


VIDIOC_QUERYCAP = _request(_READ, 0, CAPABILITY)
VIDIOC_ENUM_FMT = _request(_READ | _WRITE, 2, FORMAT_DESCRIPTION)
VIDIOC_S_FMT = _request(_READ | _WRITE, 5, FORMAT)
VIDIOC_REQBUFS = _request(_READ | _WRITE, 8, REQUEST_BUFFERS)
VIDIOC_QUERYBUF = _request(_READ | _WRITE, 9, BUFFER)
VIDIOC_QBUF = _request(_READ | _WRITE, 15, BUFFER)
VIDIOC_DQBUF = _request(_READ | _WRITE, 17, BUFFER)
VIDIOC_STREAMON = _request(_WRITE, 18, STREAM_TYPE)
VIDIOC_STREAMOFF = _request(_WRITE, 19, STREAM_TYPE)
VIDIOC_G_PARM = _request(_READ | _WRITE, 21, STREAM_PARAMETERS)
VIDIOC_S_PARM = _request(_READ | _WRITE, 22, STREAM_PARAMETERS)
VIDIOC_G_CTRL = _request(_READ | _WRITE, 27, CONTROL)
VIDIOC_S_CTRL = _request(_READ | _WRITE, 28, CONTROL)
VIDIOC_QUERYCTRL = _request(_READ | _WRITE, 36, QUERY_CONTROL)
VIDIOC_ENUM_FRAMESIZES = _request(_READ | _WRITE, 74, FRAME_SIZE)
VIDIOC_ENUM_FRAMEINTERVALS = _request(_READ | _WRITE, 75, FRAME_INTERVAL)

CAP_VIDEO_CAPTURE = 0x00000001
CAP_VIDEO_CAPTURE_MPLANE = 0x00001000
CAP_META_CAPTURE = 0x00800000
CAP_STREAMING = 0x04000000
CAP_DEVICE_CAPS = 0x80000000
CAP_TIME_PER_FRAME = 0x1000

BUF_FLAG_ERROR = 0x00000040
BUF_FLAG_TIMESTAMP_MASK = 0x0000E000
BUF_FLAG_TIMESTAMP_MONOTONIC = 0x00002000
BUF_FLAG_SOURCE_MASK = 0x00070000
BUF_FLAG_SOURCE_END_OF_FRAME = 0x00000000
BUF_FLAG_SOURCE_START_OF_EXPOSURE = 0x00010000

CID_AUTO_WHITE_BALANCE = 0x0098090C
CID_AUTOGAIN = 0x00980912
CID_GAIN = 0x00980913
CID_WHITE_BALANCE_K = 0x0098091A
CID_EXPOSURE_AUTO = 0x009A0901
CID_EXPOSURE_ABSOLUTE = 0x009A0902
CID_EXPOSURE_AUTO_PRIORITY = 0x009A0903
CID_FOCUS_ABSOLUTE = 0x009A090A
CID_FOCUS_AUTO = 0x009A090C
EXPOSURE_AUTO, EXPOSURE_MANUAL, EXPOSURE_APERTURE_PRIORITY = 0, 1, 3

BUF_TYPE_VIDEO_CAPTURE = 1
MEMORY_MMAP = 1
FIELD_ANY = 0
DISCRETE = 1
CTRL_FLAG_DISABLED = 0x1


@dataclass(frozen=True, slots=True)
class Capability:
    """What a device node says it is; `flags` are the CAP_ bits of this node, not of its whole driver."""

    driver: str
    card: str
    bus: str
    flags: int


@dataclass(frozen=True, slots=True)
class FrameSize:
    """Picture sizes in pixels that a format comes in: one size, or a range with a step."""

    min_width: int
    max_width: int
    step_width: int
    min_height: int
    max_height: int
    step_height: int

    def nearest(self, width: int, height: int) -> tuple[int, int]:
        """The offered (width, height) nearest to the one asked for."""
        return (
            _nearest_step(width, self.min_width, self.max_width, self.step_width),
            _nearest_step(height, self.min_height, self.max_height, self.step_height),
        )


def _nearest_step(wanted: int, least: int, most: int, step: int) -> int:
    clamped = min(max(wanted, least), most)
    return least + (clamped - least + step // 2) // step * step if step else clamped


@dataclass(frozen=True, slots=True)
class FrameInterval:
    """Frame periods in seconds that a size comes in: one period, or a range."""

    shortest: Fraction
    longest: Fraction

    def nearest(self, period: Fraction) -> Fraction:
        """The offered period in seconds nearest to the one asked for."""
        return min(max(period, self.shortest), self.longest)


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """The picture as it lies in memory; sizes in pixels and bytes."""

    fourcc: str
    width: int
    height: int
    bytes_per_line: int
    buffer_bytes: int = 0
    """Memory that one frame takes at most."""


@dataclass(frozen=True, slots=True)
class Buffer:
    """One buffer as the driver describes it; `timestamp_ns` in the clock that its flags name."""

    index: int
    bytes_used: int
    flags: int
    timestamp_ns: int
    sequence: int
    offset: int
    length: int
