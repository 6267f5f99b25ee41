"""Video4Linux2 as the kernel speaks it: structs and ioctls.

The structs and constants of <linux/videodev2.h> as 64-bit little-endian kernels lay them out.

Video4Linux2 as the kernel speaks it: one method for each ioctl that a camera needs.

Every method raises OSError with the kernel's errno; `driver_error` turns that into words for a user.
"""

import errno
import fcntl
import mmap
import os
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from capture_app.errors import NotAvailableError

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


_MAX_ENTRIES = 512
_NOT_OFFERED = {errno.EINVAL, errno.ENOTTY}


def check_layout() -> None:
    """Raise NotAvailableError on a machine whose kernel lays these structs out otherwise."""
    if not sys.platform.startswith("linux") or struct.calcsize("P") != 8 or sys.byteorder != "little":
        raise NotAvailableError(
            "V4L2 cameras need a 64-bit little-endian Linux",
            hint="install the 64-bit system (uname -m says x86_64 or aarch64)",
        )


class VideoDevice:
    """An open /dev/video node."""

    def __init__(self, path: str) -> None:
        """Open the node without blocking reads. Raises OSError, and NotAvailableError on a 32-bit system."""
        check_layout()
        self.path = path
        self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def close(self) -> None:
        """Close the node; the kernel stops its stream and frees its buffers once they are unmapped."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def capability(self) -> Capability:
        """Who and what this node is."""
        answer = self._ioctl(VIDIOC_QUERYCAP, bytearray(CAPABILITY.size))
        driver, card, bus, _version, capabilities, device_caps = CAPABILITY.unpack(answer)
        flags = device_caps if capabilities & CAP_DEVICE_CAPS else capabilities
        return Capability(_text(driver), _text(card), _text(bus), flags)

    def formats(self) -> tuple[str, ...]:
        """The pixel formats as four-character codes, in the driver's order."""
        answers = self._enumerate(VIDIOC_ENUM_FMT, FORMAT_DESCRIPTION, BUF_TYPE_VIDEO_CAPTURE, 0, b"", b"")
        return tuple(fields[4].decode("latin-1") for fields in answers)

    def sizes(self, fourcc: str) -> tuple[FrameSize, ...]:
        """The sizes of a pixel format; empty where the driver does not say."""
        asked = fourcc.encode("latin-1"), 0, 0, 0, 0, 0, 0, 0
        found = []
        for fields in self._enumerate(VIDIOC_ENUM_FRAMESIZES, FRAME_SIZE, *asked):
            kind, numbers = fields[2], fields[3:]
            if kind != DISCRETE:
                return (FrameSize(*numbers),)
            width, height = numbers[:2]
            found.append(FrameSize(width, width, 0, height, height, 0))
        return tuple(found)

    def intervals(self, fourcc: str, width: int, height: int) -> tuple[FrameInterval, ...]:
        """The frame periods of a format and size; empty where the driver does not say."""
        asked = fourcc.encode("latin-1"), width, height, 0, 0, 0, 0, 0, 0, 0
        found = []
        for fields in self._enumerate(VIDIOC_ENUM_FRAMEINTERVALS, FRAME_INTERVAL, *asked):
            kind, numbers = fields[4], fields[5:]
            shortest = Fraction(numbers[0], numbers[1] or 1)
            if kind != DISCRETE:
                return (FrameInterval(shortest, Fraction(numbers[2], numbers[3] or 1)),)
            found.append(FrameInterval(shortest, shortest))
        return tuple(found)

    def set_format(self, fourcc: str, width: int, height: int) -> PixelFormat:
        """Ask for a format; the driver answers with the one it took, which may differ."""
        code = fourcc.encode("latin-1")
        asked = BUF_TYPE_VIDEO_CAPTURE, width, height, code, FIELD_ANY, 0, 0
        answer = self._exchange(VIDIOC_S_FMT, FORMAT, *asked)
        _type, width, height, code, _field, bytes_per_line, buffer_bytes = answer
        return PixelFormat(code.decode("latin-1"), width, height, bytes_per_line, buffer_bytes)

    def period(self) -> Fraction | None:
        """The frame period in seconds; None where the driver cannot say."""
        asked = BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0
        try:
            answer = self._exchange(VIDIOC_G_PARM, STREAM_PARAMETERS, *asked)
        except OSError as error:
            if error.errno in _NOT_OFFERED:
                return None
            raise
        _type, _capability, _mode, numerator, denominator = answer
        return Fraction(numerator, denominator) if numerator and denominator else None

    def set_period(self, period: Fraction) -> Fraction | None:
        """Ask for a frame period in seconds; returns the one the driver took, None where it cannot say."""
        asked = CAP_TIME_PER_FRAME, 0, period.numerator, period.denominator
        try:
            self._exchange(VIDIOC_S_PARM, STREAM_PARAMETERS, BUF_TYPE_VIDEO_CAPTURE, *asked)
        except OSError as error:
            if error.errno not in _NOT_OFFERED:
                raise
        return self.period()

    def control_range(self, control: int) -> tuple[int, int] | None:
        """Least and greatest value of a control, in the control's unit; None where there is no such one."""
        asked = control, 0, b"", 0, 0, 0, 0, 0
        try:
            answer = self._exchange(VIDIOC_QUERYCTRL, QUERY_CONTROL, *asked)
        except OSError:
            return None
        _id, _type, _name, least, most, _step, _default, flags = answer
        return None if flags & CTRL_FLAG_DISABLED else (least, most)

    def control(self, control: int) -> int | None:
        """Value of a control in the control's unit; None where it does not exist or cannot be read."""
        try:
            return int(self._exchange(VIDIOC_G_CTRL, CONTROL, control, 0)[1])
        except OSError:
            return None

    def set_control(self, control: int, value: int) -> None:
        """Set a control, in the control's unit."""
        self._exchange(VIDIOC_S_CTRL, CONTROL, control, value)

    def request_buffers(self, count: int) -> int:
        """Have the driver allocate mappable buffers; returns how many it gave. 0 frees them."""
        asked = count, BUF_TYPE_VIDEO_CAPTURE, MEMORY_MMAP
        return int(self._exchange(VIDIOC_REQBUFS, REQUEST_BUFFERS, *asked)[0])

    def query_buffer(self, index: int) -> Buffer:
        """Where a buffer lies, and the timestamp flags that its frames will carry."""
        return self._exchange_buffer(VIDIOC_QUERYBUF, index)

    def map(self, buffer: Buffer) -> mmap.mmap:
        """Map a buffer's memory."""
        return mmap.mmap(self.fd, buffer.length, mmap.MAP_SHARED, mmap.PROT_READ, offset=buffer.offset)

    def queue(self, index: int) -> None:
        """Give a buffer to the driver to be filled."""
        self._exchange_buffer(VIDIOC_QBUF, index)

    def dequeue(self) -> Buffer:
        """Take the oldest filled buffer. Raises BlockingIOError when there is none yet."""
        return self._exchange_buffer(VIDIOC_DQBUF, 0)

    def stream_on(self) -> None:
        """Start streaming; may take as long as the device needs."""
        self._exchange(VIDIOC_STREAMON, STREAM_TYPE, BUF_TYPE_VIDEO_CAPTURE)

    def stream_off(self) -> None:
        """Stop streaming; every buffer, filled or not, is ours again."""
        self._exchange(VIDIOC_STREAMOFF, STREAM_TYPE, BUF_TYPE_VIDEO_CAPTURE)

    def _enumerate(self, request: int, layout: struct.Struct, *fields: Any) -> Iterator[tuple[Any, ...]]:
        """Yield the answers for index 0, 1 and so on, the first field; `fields` are those after it."""
        for index in range(_MAX_ENTRIES):
            try:
                yield self._exchange(request, layout, index, *fields)
            except OSError as error:
                if error.errno in _NOT_OFFERED:
                    return
                raise

    def _exchange(self, request: int, layout: struct.Struct, *fields: Any) -> tuple[Any, ...]:
        return layout.unpack(self._ioctl(request, bytearray(layout.pack(*fields))))

    def _exchange_buffer(self, request: int, index: int) -> Buffer:
        asked = index, BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0, 0, 0, MEMORY_MMAP, 0, 0
        answer = self._exchange(request, BUFFER, *asked)
        index, _type, bytes_used, flags, _field, seconds, microseconds, sequence, _memory, *where = answer
        timestamp_ns = seconds * 1_000_000_000 + microseconds * 1_000
        return Buffer(index, bytes_used, flags, timestamp_ns, sequence, *where)

    def _ioctl(self, request: int, argument: bytearray) -> bytearray:
        while True:
            try:
                fcntl.ioctl(self.fd, request, argument)
            except InterruptedError:
                continue
            return argument


def _text(field: bytes) -> str:
    return field.split(b"\0", 1)[0].decode("utf-8", "replace")
