"""Video4Linux2 as the kernel speaks it: one method for each ioctl that a camera needs.

Every method raises OSError with the kernel's errno; `driver_error` turns that into words for a user.
"""

import errno
import fcntl
import mmap
import os
import struct
import sys
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

from capture_app.cameras.v4l2.layout import (
    BUF_TYPE_VIDEO_CAPTURE,
    BUFFER,
    CAP_DEVICE_CAPS,
    CAP_TIME_PER_FRAME,
    CAPABILITY,
    CONTROL,
    CTRL_FLAG_DISABLED,
    DISCRETE,
    FIELD_ANY,
    FORMAT,
    FORMAT_DESCRIPTION,
    FRAME_INTERVAL,
    FRAME_SIZE,
    MEMORY_MMAP,
    QUERY_CONTROL,
    REQUEST_BUFFERS,
    STREAM_PARAMETERS,
    STREAM_TYPE,
    VIDIOC_DQBUF,
    VIDIOC_ENUM_FMT,
    VIDIOC_ENUM_FRAMEINTERVALS,
    VIDIOC_ENUM_FRAMESIZES,
    VIDIOC_G_CTRL,
    VIDIOC_G_PARM,
    VIDIOC_QBUF,
    VIDIOC_QUERYBUF,
    VIDIOC_QUERYCAP,
    VIDIOC_QUERYCTRL,
    VIDIOC_REQBUFS,
    VIDIOC_S_CTRL,
    VIDIOC_S_FMT,
    VIDIOC_S_PARM,
    VIDIOC_STREAMOFF,
    VIDIOC_STREAMON,
    Buffer,
    Capability,
    FrameInterval,
    FrameSize,
    PixelFormat,
)
from capture_app.errors import NotAvailableError

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
        request = FORMAT_DESCRIPTION
        answers = self._enumerate(
            VIDIOC_ENUM_FMT, request, lambda index: (index, BUF_TYPE_VIDEO_CAPTURE, 0, b"", b"")
        )
        return tuple(fields[4].decode("latin-1") for fields in answers)

    def sizes(self, fourcc: str) -> tuple[FrameSize, ...]:
        """The sizes of a pixel format; empty where the driver does not say."""
        code = fourcc.encode("latin-1")
        found = []
        for fields in self._enumerate(
            VIDIOC_ENUM_FRAMESIZES, FRAME_SIZE, lambda index: (index, code, 0, 0, 0, 0, 0, 0, 0)
        ):
            kind, numbers = fields[2], fields[3:]
            if kind == DISCRETE:
                width, height = numbers[:2]
                found.append(FrameSize(width, width, 0, height, height, 0))
            else:
                return (FrameSize(*numbers),)
        return tuple(found)

    def intervals(self, fourcc: str, width: int, height: int) -> tuple[FrameInterval, ...]:
        """The frame periods of a format and size; empty where the driver does not say."""
        code = fourcc.encode("latin-1")
        found = []
        for fields in self._enumerate(
            VIDIOC_ENUM_FRAMEINTERVALS,
            FRAME_INTERVAL,
            lambda index: (index, code, width, height, 0, 0, 0, 0, 0, 0, 0),
        ):
            kind, numbers = fields[4], fields[5:]
            shortest = Fraction(numbers[0], numbers[1] or 1)
            if kind == DISCRETE:
                found.append(FrameInterval(shortest, shortest))
            else:
                return (FrameInterval(shortest, Fraction(numbers[2], numbers[3] or 1)),)
        return tuple(found)

    def set_format(self, fourcc: str, width: int, height: int) -> PixelFormat:
        """Ask for a format; the driver answers with the one it took, which may differ."""
        asked = FORMAT.pack(BUF_TYPE_VIDEO_CAPTURE, width, height, fourcc.encode("latin-1"), FIELD_ANY, 0, 0)
        answer = self._ioctl(VIDIOC_S_FMT, bytearray(asked))
        _type, width, height, code, _field, bytes_per_line, buffer_bytes = FORMAT.unpack(answer)
        return PixelFormat(code.decode("latin-1"), width, height, bytes_per_line, buffer_bytes)

    def period(self) -> Fraction | None:
        """The frame period in seconds; None where the driver cannot say."""
        try:
            answer = self._ioctl(
                VIDIOC_G_PARM, bytearray(STREAM_PARAMETERS.pack(BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0))
            )
        except OSError as error:
            if error.errno in _NOT_OFFERED:
                return None
            raise
        _type, _capability, _mode, numerator, denominator = STREAM_PARAMETERS.unpack(answer)
        return Fraction(numerator, denominator) if numerator and denominator else None

    def set_period(self, period: Fraction) -> Fraction | None:
        """Ask for a frame period in seconds; returns the one the driver took, None where it cannot say."""
        asked = STREAM_PARAMETERS.pack(
            BUF_TYPE_VIDEO_CAPTURE, CAP_TIME_PER_FRAME, 0, period.numerator, period.denominator
        )
        try:
            self._ioctl(VIDIOC_S_PARM, bytearray(asked))
        except OSError as error:
            if error.errno not in _NOT_OFFERED:
                raise
        return self.period()

    def control_range(self, control: int) -> tuple[int, int] | None:
        """Least and greatest value of a control, in the control's unit; None where there is no such one."""
        asked = QUERY_CONTROL.pack(control, 0, b"", 0, 0, 0, 0, 0)
        try:
            answer = self._ioctl(VIDIOC_QUERYCTRL, bytearray(asked))
        except OSError:
            return None
        _id, _type, _name, least, most, _step, _default, flags = QUERY_CONTROL.unpack(answer)
        return None if flags & CTRL_FLAG_DISABLED else (least, most)

    def control(self, control: int) -> int | None:
        """Value of a control in the control's unit; None where it does not exist or cannot be read."""
        try:
            answer = self._ioctl(VIDIOC_G_CTRL, bytearray(CONTROL.pack(control, 0)))
        except OSError:
            return None
        return int(CONTROL.unpack(answer)[1])

    def set_control(self, control: int, value: int) -> None:
        """Set a control, in the control's unit."""
        self._ioctl(VIDIOC_S_CTRL, bytearray(CONTROL.pack(control, value)))

    def request_buffers(self, count: int) -> int:
        """Have the driver allocate mappable buffers; returns how many it gave. 0 frees them."""
        asked = REQUEST_BUFFERS.pack(count, BUF_TYPE_VIDEO_CAPTURE, MEMORY_MMAP)
        answer = self._ioctl(VIDIOC_REQBUFS, bytearray(asked))
        return int(REQUEST_BUFFERS.unpack(answer)[0])

    def query_buffer(self, index: int) -> Buffer:
        """Where a buffer lies, and the timestamp flags that its frames will carry."""
        return _buffer(self._ioctl(VIDIOC_QUERYBUF, _buffer_request(index)))

    def map(self, buffer: Buffer) -> mmap.mmap:
        """Map a buffer's memory."""
        return mmap.mmap(self.fd, buffer.length, mmap.MAP_SHARED, mmap.PROT_READ, offset=buffer.offset)

    def queue(self, index: int) -> None:
        """Give a buffer to the driver to be filled."""
        self._ioctl(VIDIOC_QBUF, _buffer_request(index))

    def dequeue(self) -> Buffer:
        """Take the oldest filled buffer. Raises BlockingIOError when there is none yet."""
        return _buffer(self._ioctl(VIDIOC_DQBUF, _buffer_request(0)))

    def stream_on(self) -> None:
        """Start streaming; may take as long as the device needs."""
        self._ioctl(VIDIOC_STREAMON, bytearray(STREAM_TYPE.pack(BUF_TYPE_VIDEO_CAPTURE)))

    def stream_off(self) -> None:
        """Stop streaming; every buffer, filled or not, is ours again."""
        self._ioctl(VIDIOC_STREAMOFF, bytearray(STREAM_TYPE.pack(BUF_TYPE_VIDEO_CAPTURE)))

    def _enumerate(
        self, request: int, layout: struct.Struct, fields_of: Callable[[int], tuple[Any, ...]]
    ) -> Iterator[tuple[Any, ...]]:
        for index in range(_MAX_ENTRIES):
            try:
                answer = self._ioctl(request, bytearray(layout.pack(*fields_of(index))))
            except OSError as error:
                if error.errno in _NOT_OFFERED:
                    return
                raise
            yield layout.unpack(answer)

    def _ioctl(self, request: int, argument: bytearray) -> bytearray:
        while True:
            try:
                fcntl.ioctl(self.fd, request, argument)
            except InterruptedError:
                continue
            return argument


def _buffer_request(index: int) -> bytearray:
    return bytearray(BUFFER.pack(index, BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0, 0, 0, MEMORY_MMAP, 0, 0))


def _buffer(answer: bytearray) -> Buffer:
    (index, _type, bytes_used, flags, _field, seconds, microseconds, sequence, _memory, offset, length) = (
        BUFFER.unpack(answer)
    )
    timestamp_ns = seconds * 1_000_000_000 + microseconds * 1_000
    return Buffer(index, bytes_used, flags, timestamp_ns, sequence, offset, length)


def _text(field: bytes) -> str:
    return field.split(b"\0", 1)[0].decode("utf-8", "replace")
