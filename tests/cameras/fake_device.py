"""V4L2 devices whose frames, modes and failures come from the test."""

import mmap
import os
import threading
import time
from fractions import Fraction

from capture_app.cameras.v4l2.ioctl import VideoDevice
from capture_app.cameras.v4l2.layout import (
    BUF_FLAG_SOURCE_START_OF_EXPOSURE,
    BUF_FLAG_TIMESTAMP_MONOTONIC,
    CAP_STREAMING,
    CAP_VIDEO_CAPTURE,
    CID_EXPOSURE_ABSOLUTE,
    CID_GAIN,
    Buffer,
    Capability,
    FrameInterval,
    FrameSize,
    PixelFormat,
)

MJPG = PixelFormat("MJPG", 640, 480, 0)
PERIOD_NS = 33_333_333
START_OF_EXPOSURE = BUF_FLAG_TIMESTAMP_MONOTONIC | BUF_FLAG_SOURCE_START_OF_EXPOSURE
JPEG = b"\xff\xd8 any bytes a camera calls a JPEG"


class FakeDevice(VideoDevice):
    """A driver with the kernel's rules for buffers; tests deliver its frames."""

    def __init__(self, flags: int = START_OF_EXPOSURE) -> None:
        self.path = "/dev/video0"
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self.flags = flags
        self.asked_buffers = 0
        self.controls = {CID_EXPOSURE_ABSOLUTE: 157, CID_GAIN: 4}
        self.calls: list[str] = []
        self.on_times_ns: list[int] = []
        self.queued: list[int] = []
        self.filled: list[Buffer] = []
        self.dequeue_error: int | None = None
        self.stream_on_error: int | None = None
        self.may_start = threading.Event()
        self.may_start.set()
        self._memory = [mmap.mmap(-1, 4096) for _ in range(3)]

    def deliver(self, sequence: int, data: bytes = JPEG, flags: int = 0, age_ns: int = 0) -> int:
        """Fill the oldest queued buffer; returns its timestamp in ns."""
        index = self.queued.pop(0)
        self._memory[index][: len(data)] = data
        timestamp_ns = time.monotonic_ns() - age_ns
        self.filled.append(Buffer(index, len(data), self.flags | flags, timestamp_ns, sequence, 0, 4096))
        os.eventfd_write(self.fd, 1)
        return timestamp_ns

    def unplug(self, code: int) -> None:
        self.dequeue_error = code
        os.eventfd_write(self.fd, 1)

    def close(self) -> None:
        self.calls.append("close")
        os.close(self.fd)
        self.fd = -1

    def capability(self) -> Capability:
        return Capability("fake", "Fake camera", "usb-1", CAP_VIDEO_CAPTURE | CAP_STREAMING)

    def control(self, control: int) -> int | None:
        return self.controls.get(control)

    def control_range(self, control: int) -> tuple[int, int] | None:
        return (1, 5000) if control in self.controls else None

    def set_control(self, control: int, value: int) -> None:
        self.controls[control] = value

    def request_buffers(self, count: int) -> int:
        self.asked_buffers = count
        return min(count, len(self._memory))

    def query_buffer(self, index: int) -> Buffer:
        return Buffer(index, 0, self.flags, 0, 0, index * 4096, 4096)

    def map(self, buffer: Buffer) -> mmap.mmap:
        return self._memory[buffer.index]

    def queue(self, index: int) -> None:
        assert index not in self.queued, "the kernel answers EINVAL to a buffer that is queued already"
        self.queued.append(index)

    def dequeue(self) -> Buffer:
        if self.dequeue_error is not None:
            raise OSError(self.dequeue_error, "unplugged")
        if not self.filled:
            os.eventfd_read(self.fd)
            raise BlockingIOError
        return self.filled.pop(0)

    def stream_on(self) -> None:
        self.may_start.wait()
        self.calls.append("on")
        self.on_times_ns.append(time.monotonic_ns())
        if self.stream_on_error is not None:
            raise OSError(self.stream_on_error, "no")

    def stream_off(self) -> None:
        self.calls.append("off")
        self.queued, self.filled = [], []


class FickleDevice(FakeDevice):
    """A driver that offers one mode and takes another."""

    def __init__(self, taken: PixelFormat, rate: int) -> None:
        super().__init__()
        self._taken, self._rate = taken, rate

    def formats(self) -> tuple[str, ...]:
        return ("MJPG", "H264")

    def sizes(self, fourcc: str) -> tuple[FrameSize, ...]:
        return (FrameSize(640, 640, 0, 480, 480, 0),)

    def intervals(self, fourcc: str, width: int, height: int) -> tuple[FrameInterval, ...]:
        return tuple(FrameInterval(Fraction(1, rate), Fraction(1, rate)) for rate in (30, 15))

    def set_format(self, fourcc: str, width: int, height: int) -> PixelFormat:
        return self._taken

    def set_period(self, period: Fraction) -> Fraction:
        return Fraction(1, self._rate)
