"""Video4Linux2's kernel interface: a method for each ioctl that a camera needs.

Structs and constants follow <linux/videodev2.h> in the layout of 64-bit little-endian kernels. Every method
raises OSError with the kernel's errno; `driver_error` turns it into a message for users.
"""

import errno
import mmap
import os
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from struct import Struct
from typing import Any

from capture_app.cameras.frames import PixelFormat
from capture_app.common import system
from capture_app.common.errors import CameraError, NotAvailableError

with suppress(ImportError):  # Linux has it; `check_layout` refuses other systems
    import fcntl

_BUFFER = Struct("<5I4xqq16xIII4xI12x")
_READ, _WRITE = 2, 1
_BOTH = _READ | _WRITE
IOCTLS = {
    "QUERYCAP": (_READ, 0, Struct("<16s32s32sIII12x")),
    "ENUM_FMT": (_BOTH, 2, Struct("<III32s4s16x")),
    "S_FMT": (_BOTH, 5, Struct("<I4xII4sIII176x")),
    "REQBUFS": (_BOTH, 8, Struct("<III8x")),
    "QUERYBUF": (_BOTH, 9, _BUFFER),
    "QBUF": (_BOTH, 15, _BUFFER),
    "DQBUF": (_BOTH, 17, _BUFFER),
    "STREAMON": (_WRITE, 18, Struct("<i")),
    "STREAMOFF": (_WRITE, 19, Struct("<i")),
    "G_PARM": (_BOTH, 21, Struct("<IIIII184x")),
    "S_PARM": (_BOTH, 22, Struct("<IIIII184x")),
    "G_CTRL": (_BOTH, 27, Struct("<Ii")),
    "S_CTRL": (_BOTH, 28, Struct("<Ii")),
    "QUERYCTRL": (_BOTH, 36, Struct("<II32siiiiI8x")),
    "ENUM_FRAMESIZES": (_BOTH, 74, Struct("<I4sI6I8x")),
    "ENUM_FRAMEINTERVALS": (_BOTH, 75, Struct("<I4sIII6I8x")),
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
            hint="on other systems give webcam:0, or webcam:NAME; capture-app cameras lists them"
            if sys.platform in ("win32", "darwin")
            else "install the 64-bit system (uname -m says x86_64 or aarch64)",
        )


class VideoDevice:
    """An open /dev/video node."""

    def __init__(self, path: str) -> None:
        """Open the node in non-blocking mode. Raises OSError, and NotAvailableError on a 32-bit system."""
        check_layout()
        self.path = path
        self.fd = system.open_file(path, os.O_RDWR)

    def close(self) -> None:
        """Close the node; the kernel stops its stream and frees its buffers once they are unmapped."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def capability(self) -> tuple[str, str, int]:
        """Return the node's driver, its model, and the CAP_ bits of this node, not of its whole driver."""
        driver, card, _bus, _version, capabilities, device_caps = self._exchange(
            "QUERYCAP", b"", b"", b"", 0, 0, 0
        )
        flags = device_caps if capabilities & CAP_DEVICE_CAPS else capabilities
        return _text(driver), _text(card), flags

    def formats(self) -> tuple[str, ...]:
        """Return the pixel formats as four-character codes, in the driver's order."""
        return tuple(
            fields[4].decode("latin-1")
            for fields in self._enumerate("ENUM_FMT", BUF_TYPE_VIDEO_CAPTURE, 0, b"", b"")
        )

    def sizes(self, fourcc: str) -> tuple[tuple[range, range], ...]:
        """Return the widths and heights in pixels of a format: single sizes, or one pair of ranges.

        Empty if the driver does not report them.
        """
        asked = fourcc.encode("latin-1"), 0, 0, 0, 0, 0, 0, 0
        intervals = []
        for _index, _fourcc, kind, *numbers in self._enumerate("ENUM_FRAMESIZES", *asked):
            if kind != DISCRETE:
                return ((_steps(*numbers[:3]), _steps(*numbers[3:])),)
            width, height = numbers[:2]
            intervals.append((_steps(width, width), _steps(height, height)))
        return tuple(intervals)

    def intervals(self, fourcc: str, width: int, height: int) -> tuple[tuple[Fraction, Fraction], ...]:
        """Return the frame periods (shortest, longest) in seconds: single ones are equal, or one range.

        Empty if the driver does not report them.
        """
        asked = fourcc.encode("latin-1"), width, height, 0, 0, 0, 0, 0, 0, 0
        intervals = []
        for _index, _fourcc, _width, _height, kind, *numbers in self._enumerate(
            "ENUM_FRAMEINTERVALS", *asked
        ):
            shortest = Fraction(numbers[0], numbers[1] or 1)
            if kind != DISCRETE:
                return ((shortest, Fraction(numbers[2], numbers[3] or 1)),)
            intervals.append((shortest, shortest))
        return tuple(intervals)

    def set_format(self, fourcc: str, width: int, height: int) -> PixelFormat:
        """Request a format; return the one that the driver set, which may differ."""
        asked = BUF_TYPE_VIDEO_CAPTURE, width, height, fourcc.encode("latin-1"), FIELD_ANY, 0, 0
        _type, width, height, code, _field, bytes_per_line, buffer_bytes = self._exchange("S_FMT", *asked)
        return PixelFormat(code.decode("latin-1"), width, height, bytes_per_line, buffer_bytes)

    def period(self) -> Fraction | None:
        """Return the frame period in seconds; None if the driver does not report it."""
        answer = self._if_offered("G_PARM", BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0)
        numerator, denominator = (0, 0) if answer is None else answer[3:]
        return Fraction(numerator, denominator) if numerator and denominator else None

    def set_period(self, period: Fraction) -> Fraction | None:
        """Request a frame period in seconds; return the one that the driver set, None if unreported."""
        self._if_offered(
            "S_PARM", BUF_TYPE_VIDEO_CAPTURE, CAP_TIME_PER_FRAME, 0, period.numerator, period.denominator
        )
        return self.period()

    def control_range(self, control: str) -> tuple[int, int] | None:
        """Return min and max of a control, in the control's unit; None if it does not exist."""
        with suppress(OSError):
            _id, _type, _name, low, high, _step, _default, flags = self._exchange(
                "QUERYCTRL", CONTROL_IDS[control], 0, b"", 0, 0, 0, 0, 0
            )
            return None if flags & CTRL_FLAG_DISABLED else (low, high)
        return None

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
        for index in range(512):
            if (answer := self._if_offered(ioctl, index, *fields)) is None:
                return
            yield answer

    def _if_offered(self, ioctl: str, *fields: Any) -> tuple[Any, ...] | None:
        """Return the answer of `_exchange`; None if the driver does not offer the ioctl or entry."""
        try:
            return self._exchange(ioctl, *fields)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTTY):
                raise
            return None

    def _exchange(self, ioctl: str, *fields: Any) -> tuple[Any, ...]:
        """Pass an ioctl's struct of these fields to the kernel; return the fields of its answer."""
        layout = IOCTLS[ioctl][2]
        argument = bytearray(layout.pack(*fields))
        while True:
            with suppress(InterruptedError):
                fcntl.ioctl(self.fd, request_number(ioctl), argument)
                return layout.unpack(argument)

    def _exchange_buffer(self, ioctl: str, index: int) -> Buffer:
        answer = self._exchange(ioctl, index, BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0, 0, 0, MEMORY_MMAP, 0, 0)
        index, _type, bytes_used, flags, _field, seconds, microseconds, sequence, _memory, *where = answer
        return Buffer(
            index, bytes_used, flags, seconds * 1_000_000_000 + microseconds * 1_000, sequence, *where
        )


def _steps(low: int, high: int, step: int = 1) -> range:
    return range(low, high + 1, step or 1)


def _text(field: bytes) -> str:
    return field.split(b"\0", 1)[0].decode("utf-8", "replace")


def driver_error(path: str, error: OSError) -> CameraError:
    """Convert a driver's error to a message with a remedy."""
    reason = os.strerror(error.errno) if error.errno else str(error)
    unknown = "{path} failed: {reason}", "the kernel log (`dmesg`) may say more"
    what, hint = _WORDS.get(error.errno or 0, unknown)
    return CameraError(what.format(path=path, reason=reason), hint=hint.format(path=path))
