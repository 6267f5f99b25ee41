"""Video4Linux2 as the kernel speaks it: one method for each ioctl that a camera needs.

Every method raises OSError with the kernel's errno; `driver_error` turns that into words for a user.
"""

import errno
import fcntl
import mmap
import os
import struct
import sys
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

from capture_app.cameras.v4l2 import layout as v4l2
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

    def capability(self) -> v4l2.Capability:
        """Who and what this node is."""
        answer = self._ioctl(v4l2.VIDIOC_QUERYCAP, bytearray(v4l2.CAPABILITY.size))
        driver, card, bus, _version, capabilities, device_caps = v4l2.CAPABILITY.unpack(answer)
        flags = device_caps if capabilities & v4l2.CAP_DEVICE_CAPS else capabilities
        return v4l2.Capability(_text(driver), _text(card), _text(bus), flags)

    def formats(self) -> tuple[str, ...]:
        """The pixel formats as four-character codes, in the driver's order."""
        answers = self._enumerate(
            v4l2.VIDIOC_ENUM_FMT, v4l2.FORMAT_DESCRIPTION, v4l2.BUF_TYPE_VIDEO_CAPTURE, 0, b"", b""
        )
        return tuple(fields[4].decode("latin-1") for fields in answers)

    def sizes(self, fourcc: str) -> tuple[v4l2.FrameSize, ...]:
        """The sizes of a pixel format; empty where the driver does not say."""
        asked = fourcc.encode("latin-1"), 0, 0, 0, 0, 0, 0, 0
        found = []
        for fields in self._enumerate(v4l2.VIDIOC_ENUM_FRAMESIZES, v4l2.FRAME_SIZE, *asked):
            kind, numbers = fields[2], fields[3:]
            if kind != v4l2.DISCRETE:
                return (v4l2.FrameSize(*numbers),)
            width, height = numbers[:2]
            found.append(v4l2.FrameSize(width, width, 0, height, height, 0))
        return tuple(found)

    def intervals(self, fourcc: str, width: int, height: int) -> tuple[v4l2.FrameInterval, ...]:
        """The frame periods of a format and size; empty where the driver does not say."""
        asked = fourcc.encode("latin-1"), width, height, 0, 0, 0, 0, 0, 0, 0
        found = []
        for fields in self._enumerate(v4l2.VIDIOC_ENUM_FRAMEINTERVALS, v4l2.FRAME_INTERVAL, *asked):
            kind, numbers = fields[4], fields[5:]
            shortest = Fraction(numbers[0], numbers[1] or 1)
            if kind != v4l2.DISCRETE:
                return (v4l2.FrameInterval(shortest, Fraction(numbers[2], numbers[3] or 1)),)
            found.append(v4l2.FrameInterval(shortest, shortest))
        return tuple(found)

    def set_format(self, fourcc: str, width: int, height: int) -> v4l2.PixelFormat:
        """Ask for a format; the driver answers with the one it took, which may differ."""
        code = fourcc.encode("latin-1")
        asked = v4l2.BUF_TYPE_VIDEO_CAPTURE, width, height, code, v4l2.FIELD_ANY, 0, 0
        answer = self._exchange(v4l2.VIDIOC_S_FMT, v4l2.FORMAT, *asked)
        _type, width, height, code, _field, bytes_per_line, buffer_bytes = answer
        return v4l2.PixelFormat(code.decode("latin-1"), width, height, bytes_per_line, buffer_bytes)

    def period(self) -> Fraction | None:
        """The frame period in seconds; None where the driver cannot say."""
        asked = v4l2.BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0
        try:
            answer = self._exchange(v4l2.VIDIOC_G_PARM, v4l2.STREAM_PARAMETERS, *asked)
        except OSError as error:
            if error.errno in _NOT_OFFERED:
                return None
            raise
        _type, _capability, _mode, numerator, denominator = answer
        return Fraction(numerator, denominator) if numerator and denominator else None

    def set_period(self, period: Fraction) -> Fraction | None:
        """Ask for a frame period in seconds; returns the one the driver took, None where it cannot say."""
        asked = v4l2.CAP_TIME_PER_FRAME, 0, period.numerator, period.denominator
        try:
            self._exchange(v4l2.VIDIOC_S_PARM, v4l2.STREAM_PARAMETERS, v4l2.BUF_TYPE_VIDEO_CAPTURE, *asked)
        except OSError as error:
            if error.errno not in _NOT_OFFERED:
                raise
        return self.period()

    def control_range(self, control: int) -> tuple[int, int] | None:
        """Least and greatest value of a control, in the control's unit; None where there is no such one."""
        asked = control, 0, b"", 0, 0, 0, 0, 0
        try:
            answer = self._exchange(v4l2.VIDIOC_QUERYCTRL, v4l2.QUERY_CONTROL, *asked)
        except OSError:
            return None
        _id, _type, _name, least, most, _step, _default, flags = answer
        return None if flags & v4l2.CTRL_FLAG_DISABLED else (least, most)

    def control(self, control: int) -> int | None:
        """Value of a control in the control's unit; None where it does not exist or cannot be read."""
        try:
            return int(self._exchange(v4l2.VIDIOC_G_CTRL, v4l2.CONTROL, control, 0)[1])
        except OSError:
            return None

    def set_control(self, control: int, value: int) -> None:
        """Set a control, in the control's unit."""
        self._exchange(v4l2.VIDIOC_S_CTRL, v4l2.CONTROL, control, value)

    def request_buffers(self, count: int) -> int:
        """Have the driver allocate mappable buffers; returns how many it gave. 0 frees them."""
        asked = count, v4l2.BUF_TYPE_VIDEO_CAPTURE, v4l2.MEMORY_MMAP
        return int(self._exchange(v4l2.VIDIOC_REQBUFS, v4l2.REQUEST_BUFFERS, *asked)[0])

    def query_buffer(self, index: int) -> v4l2.Buffer:
        """Where a buffer lies, and the timestamp flags that its frames will carry."""
        return self._exchange_buffer(v4l2.VIDIOC_QUERYBUF, index)

    def map(self, buffer: v4l2.Buffer) -> mmap.mmap:
        """Map a buffer's memory."""
        return mmap.mmap(self.fd, buffer.length, mmap.MAP_SHARED, mmap.PROT_READ, offset=buffer.offset)

    def queue(self, index: int) -> None:
        """Give a buffer to the driver to be filled."""
        self._exchange_buffer(v4l2.VIDIOC_QBUF, index)

    def dequeue(self) -> v4l2.Buffer:
        """Take the oldest filled buffer. Raises BlockingIOError when there is none yet."""
        return self._exchange_buffer(v4l2.VIDIOC_DQBUF, 0)

    def stream_on(self) -> None:
        """Start streaming; may take as long as the device needs."""
        self._exchange(v4l2.VIDIOC_STREAMON, v4l2.STREAM_TYPE, v4l2.BUF_TYPE_VIDEO_CAPTURE)

    def stream_off(self) -> None:
        """Stop streaming; every buffer, filled or not, is ours again."""
        self._exchange(v4l2.VIDIOC_STREAMOFF, v4l2.STREAM_TYPE, v4l2.BUF_TYPE_VIDEO_CAPTURE)

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

    def _exchange_buffer(self, request: int, index: int) -> v4l2.Buffer:
        asked = index, v4l2.BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0, 0, 0, v4l2.MEMORY_MMAP, 0, 0
        answer = self._exchange(request, v4l2.BUFFER, *asked)
        index, _type, bytes_used, flags, _field, seconds, microseconds, sequence, _memory, *where = answer
        timestamp_ns = seconds * 1_000_000_000 + microseconds * 1_000
        return v4l2.Buffer(index, bytes_used, flags, timestamp_ns, sequence, *where)

    def _ioctl(self, request: int, argument: bytearray) -> bytearray:
        while True:
            try:
                fcntl.ioctl(self.fd, request, argument)
            except InterruptedError:
                continue
            return argument


def _text(field: bytes) -> str:
    return field.split(b"\0", 1)[0].decode("utf-8", "replace")
