"""Video4Linux2's kernel interface: a method for each ioctl that a camera needs.

Structs and constants follow <linux/videodev2.h> in the layout of 64-bit little-endian kernels. Every method
raises OSError with the kernel's errno; `driver_error` turns it into a message for users.
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

from capture_app.cameras.frames import PixelFormat
from capture_app.common.errors import CameraError, NotAvailableError

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
_BOTH = _READ | _WRITE
IOCTLS = {
    "QUERYCAP": (_READ, 0, CAPABILITY),
    "ENUM_FMT": (_BOTH, 2, FORMAT_DESCRIPTION),
    "S_FMT": (_BOTH, 5, FORMAT),
    "REQBUFS": (_BOTH, 8, REQUEST_BUFFERS),
    "QUERYBUF": (_BOTH, 9, BUFFER),
    "QBUF": (_BOTH, 15, BUFFER),
    "DQBUF": (_BOTH, 17, BUFFER),
    "STREAMON": (_WRITE, 18, STREAM_TYPE),
    "STREAMOFF": (_WRITE, 19, STREAM_TYPE),
    "G_PARM": (_BOTH, 21, STREAM_PARAMETERS),
    "S_PARM": (_BOTH, 22, STREAM_PARAMETERS),
    "G_CTRL": (_BOTH, 27, CONTROL),
    "S_CTRL": (_BOTH, 28, CONTROL),
    "QUERYCTRL": (_BOTH, 36, QUERY_CONTROL),
    "ENUM_FRAMESIZES": (_BOTH, 74, FRAME_SIZE),
    "ENUM_FRAMEINTERVALS": (_BOTH, 75, FRAME_INTERVAL),
}
"""VIDIOC_ name to transfer direction, number and struct."""
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
CONTROL_IDS = {
    "AUTO_WHITE_BALANCE": 0x0098090C,
    "AUTOGAIN": 0x00980912,
    "GAIN": 0x00980913,
    "WHITE_BALANCE_K": 0x0098091A,
    "EXPOSURE_AUTO": 0x009A0901,
    "EXPOSURE_ABSOLUTE": 0x009A0902,
    "EXPOSURE_AUTO_PRIORITY": 0x009A0903,
    "FOCUS_ABSOLUTE": 0x009A090A,
    "FOCUS_AUTO": 0x009A090C,
}
"""Control numbers, by the kernel's names without V4L2_CID_, some of them shortened."""
EXPOSURE_AUTO, EXPOSURE_MANUAL, EXPOSURE_APERTURE_PRIORITY = 0, 1, 3
BUF_TYPE_VIDEO_CAPTURE = 1
MEMORY_MMAP = 1
FIELD_ANY = 0
DISCRETE = 1
CTRL_FLAG_DISABLED = 0x1
_MAX_ENTRIES = 512
_NOT_OFFERED = {errno.EINVAL, errno.ENOTTY}
_LIST = "`capture-app cameras` lists the cameras"
_NO_CAMERA = "{path} is not a camera", _LIST
_NOT_PERMITTED = (
    "no permission to use {path}",
    "add yourself to the group `video`: sudo usermod -aG video $USER, then log in again",
)
_SILENT = "{path} does not answer any more", "check its plug and cable, then start it again"
_WORDS = {
    errno.ENOENT: ("there is no camera {path}", _LIST),
    errno.EACCES: _NOT_PERMITTED,
    errno.EPERM: _NOT_PERMITTED,
    errno.EBUSY: ("{path} is in use by another program", "close it; `fuser -v {path}` names it"),
    **dict.fromkeys((errno.ENOTTY, errno.EISDIR, errno.ENXIO), _NO_CAMERA),
    errno.ENOSPC: (
        "{path} cannot start: the USB bus has no bandwidth left for it",
        "choose format=MJPG, a smaller size or rate, or another USB port",
    ),
    **dict.fromkeys((errno.ENODEV, errno.EIO, errno.ESHUTDOWN, errno.EPROTO, errno.ETIMEDOUT), _SILENT),
}


def request_number(ioctl: str) -> int:
    """Return the kernel's request number of one of `IOCTLS`."""
    direction, number, layout = IOCTLS[ioctl]
    return direction << 30 | layout.size << 16 | ord("V") << 8 | number


@dataclass(frozen=True, slots=True)
class Capability:
    """A device node's identity; `flags` are the CAP_ bits of this node, not of its whole driver."""

    driver: str
    card: str
    flags: int


@dataclass(frozen=True, slots=True)
class FrameSize:
    """Image sizes in pixels of a format: one size, or ranges with their steps."""

    widths: range
    heights: range

    def nearest(self, width: int, height: int) -> tuple[int, int]:
        """Return the offered (width, height) nearest to the requested one."""
        return _nearest(width, self.widths), _nearest(height, self.heights)


def _nearest(target: int, offered: range) -> int:
    beyond = min(max(target, offered.start), offered.stop - 1) - offered.start
    return offered.start + (beyond + offered.step // 2) // offered.step * offered.step


@dataclass(frozen=True, slots=True)
class FrameInterval:
    """Frame periods in seconds of a size: one period, or a range."""

    shortest: Fraction
    longest: Fraction

    def nearest(self, period: Fraction) -> Fraction:
        """Return the offered period in seconds nearest to the requested one."""
        return min(max(period, self.shortest), self.longest)


@dataclass(frozen=True, slots=True)
class Buffer:
    """Driver's description of a buffer; `timestamp_ns` in the clock that its flags name."""

    index: int
    bytes_used: int
    flags: int
    timestamp_ns: int
    sequence: int
    offset: int
    length: int


def check_layout() -> None:
    """Raise NotAvailableError on a machine whose kernel uses another layout of these structs."""
    if not sys.platform.startswith("linux") or struct.calcsize("P") != 8 or sys.byteorder != "little":
        raise NotAvailableError(
            "V4L2 cameras need a 64-bit little-endian Linux",
            hint="install the 64-bit system (uname -m says x86_64 or aarch64)",
        )


class VideoDevice:
    """An open /dev/video node."""

    def __init__(self, path: str) -> None:
        """Open the node in non-blocking mode. Raises OSError, and NotAvailableError on a 32-bit system."""
        check_layout()
        self.path = path
        self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def close(self) -> None:
        """Close the node; the kernel stops its stream and frees its buffers once they are unmapped."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def capability(self) -> Capability:
        """Return the node's driver, model and capabilities."""
        answer = self._exchange("QUERYCAP", b"", b"", b"", 0, 0, 0)
        driver, card, _bus, _version, capabilities, device_caps = answer
        flags = device_caps if capabilities & CAP_DEVICE_CAPS else capabilities
        return Capability(_text(driver), _text(card), flags)

    def formats(self) -> tuple[str, ...]:
        """Return the pixel formats as four-character codes, in the driver's order."""
        answers = self._enumerate("ENUM_FMT", BUF_TYPE_VIDEO_CAPTURE, 0, b"", b"")
        return tuple(fields[4].decode("latin-1") for fields in answers)

    def sizes(self, fourcc: str) -> tuple[FrameSize, ...]:
        """Return the sizes of a pixel format; empty if the driver does not report them."""
        asked = fourcc.encode("latin-1"), 0, 0, 0, 0, 0, 0, 0
        found = []
        for fields in self._enumerate("ENUM_FRAMESIZES", *asked):
            kind, numbers = fields[2], fields[3:]
            if kind != DISCRETE:
                return (FrameSize(_steps(*numbers[:3]), _steps(*numbers[3:])),)
            width, height = numbers[:2]
            found.append(FrameSize(_steps(width, width), _steps(height, height)))
        return tuple(found)

    def intervals(self, fourcc: str, width: int, height: int) -> tuple[FrameInterval, ...]:
        """Return the frame periods of a format and size; empty if the driver does not report them."""
        asked = fourcc.encode("latin-1"), width, height, 0, 0, 0, 0, 0, 0, 0
        found = []
        for fields in self._enumerate("ENUM_FRAMEINTERVALS", *asked):
            kind, numbers = fields[4], fields[5:]
            shortest = Fraction(numbers[0], numbers[1] or 1)
            if kind != DISCRETE:
                return (FrameInterval(shortest, Fraction(numbers[2], numbers[3] or 1)),)
            found.append(FrameInterval(shortest, shortest))
        return tuple(found)

    def set_format(self, fourcc: str, width: int, height: int) -> PixelFormat:
        """Request a format; return the one that the driver set, which may differ."""
        code = fourcc.encode("latin-1")
        asked = BUF_TYPE_VIDEO_CAPTURE, width, height, code, FIELD_ANY, 0, 0
        answer = self._exchange("S_FMT", *asked)
        _type, width, height, code, _field, bytes_per_line, buffer_bytes = answer
        return PixelFormat(code.decode("latin-1"), width, height, bytes_per_line, buffer_bytes)

    def period(self) -> Fraction | None:
        """Return the frame period in seconds; None if the driver does not report it."""
        answer = self._if_offered("G_PARM", BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0)
        if answer is None:
            return None
        _type, _capability, _mode, numerator, denominator = answer
        return Fraction(numerator, denominator) if numerator and denominator else None

    def set_period(self, period: Fraction) -> Fraction | None:
        """Request a frame period in seconds; return the one that the driver set, None if unreported."""
        rate = period.numerator, period.denominator
        self._if_offered("S_PARM", BUF_TYPE_VIDEO_CAPTURE, CAP_TIME_PER_FRAME, 0, *rate)
        return self.period()

    def control_range(self, control: str) -> tuple[int, int] | None:
        """Return min and max of a control, in the control's unit; None if it does not exist."""
        asked = CONTROL_IDS[control], 0, b"", 0, 0, 0, 0, 0
        try:
            answer = self._exchange("QUERYCTRL", *asked)
        except OSError:
            return None
        _id, _type, _name, low, high, _step, _default, flags = answer
        return None if flags & CTRL_FLAG_DISABLED else (low, high)

    def control(self, control: str) -> int | None:
        """Return one of `CONTROL_IDS` in its own unit; None if it does not exist or cannot be read."""
        try:
            return int(self._exchange("G_CTRL", CONTROL_IDS[control], 0)[1])
        except OSError:
            return None

    def set_control(self, control: str, value: int) -> None:
        """Set a control, in the control's unit."""
        self._exchange("S_CTRL", CONTROL_IDS[control], value)

    def request_buffers(self, count: int) -> int:
        """Request mappable buffers from the driver; return the number allocated. 0 frees them."""
        return int(self._exchange("REQBUFS", count, BUF_TYPE_VIDEO_CAPTURE, MEMORY_MMAP)[0])

    def query_buffer(self, index: int) -> Buffer:
        """Return a buffer's offset and length, and the timestamp flags that its frames will carry."""
        return self._exchange_buffer("QUERYBUF", index)

    def map(self, buffer: Buffer) -> mmap.mmap:
        """Map a buffer's memory."""
        return mmap.mmap(self.fd, buffer.length, mmap.MAP_SHARED, mmap.PROT_READ, offset=buffer.offset)

    def queue(self, index: int) -> None:
        """Queue a buffer for the driver to fill."""
        self._exchange_buffer("QBUF", index)

    def dequeue(self) -> Buffer:
        """Dequeue the oldest filled buffer. Raises BlockingIOError if there is none yet."""
        return self._exchange_buffer("DQBUF", 0)

    def stream_on(self) -> None:
        """Start streaming; may take as long as the device needs."""
        self._exchange("STREAMON", BUF_TYPE_VIDEO_CAPTURE)

    def stream_off(self) -> None:
        """Stop streaming; the driver returns every buffer, filled or not."""
        self._exchange("STREAMOFF", BUF_TYPE_VIDEO_CAPTURE)

    def _enumerate(self, ioctl: str, *fields: Any) -> Iterator[tuple[Any, ...]]:
        """Yield the answers for index 0, 1 and so on, the first field; `fields` are the ones after it."""
        for index in range(_MAX_ENTRIES):
            answer = self._if_offered(ioctl, index, *fields)
            if answer is None:
                return
            yield answer

    def _if_offered(self, ioctl: str, *fields: Any) -> tuple[Any, ...] | None:
        """Return the answer of `_exchange`; None if the driver does not offer the ioctl or entry."""
        try:
            return self._exchange(ioctl, *fields)
        except OSError as error:
            if error.errno not in _NOT_OFFERED:
                raise
            return None

    def _exchange(self, ioctl: str, *fields: Any) -> tuple[Any, ...]:
        """Pass an ioctl's struct of these fields to the kernel; return the fields of its answer."""
        layout = IOCTLS[ioctl][2]
        argument = bytearray(layout.pack(*fields))
        while True:
            try:
                fcntl.ioctl(self.fd, request_number(ioctl), argument)
            except InterruptedError:
                continue
            return layout.unpack(argument)

    def _exchange_buffer(self, ioctl: str, index: int) -> Buffer:
        asked = index, BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0, 0, 0, MEMORY_MMAP, 0, 0
        answer = self._exchange(ioctl, *asked)
        index, _type, bytes_used, flags, _field, seconds, microseconds, sequence, _memory, *where = answer
        timestamp_ns = seconds * 1_000_000_000 + microseconds * 1_000
        return Buffer(index, bytes_used, flags, timestamp_ns, sequence, *where)


def _steps(low: int, high: int, step: int = 1) -> range:
    return range(low, high + 1, step or 1)


def _text(field: bytes) -> str:
    return field.split(b"\0", 1)[0].decode("utf-8", "replace")


def driver_error(path: str, error: OSError) -> CameraError:
    """Convert a driver's error to a message with a remedy."""
    words = _WORDS.get(error.errno or 0)
    if words is None:
        reason = os.strerror(error.errno) if error.errno else str(error)
        return CameraError(f"{path} failed: {reason}", hint="the kernel log (`dmesg`) may say more")
    what, hint = words
    return CameraError(what.format(path=path), hint=hint.format(path=path))
