"""V4L2 devices whose frames, modes and failures come from the test."""

import mmap
import os
import threading
import time
from fractions import Fraction

from capture_app.cameras.frames import PixelFormat
from capture_app.plugins.cameras.v4l2 import kernel as v4l2
from capture_app.plugins.cameras.v4l2.kernel import VideoDevice
from tests.images import small_jpeg

MJPG = PixelFormat("MJPG", 640, 480, 0)
PERIOD_NS = 33_333_333
START_OF_EXPOSURE = v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC | v4l2.BUF_FLAG_SOURCE_START_OF_EXPOSURE
JPEG = small_jpeg(b"any bytes a camera calls pixels")


def rates(*fps: int) -> tuple[tuple[Fraction, Fraction], ...]:
    return tuple((Fraction(1, rate), Fraction(1, rate)) for rate in fps)


class FakeDevice(VideoDevice):
    """A driver with the kernel's rules for buffers; tests deliver its frames."""

    def __init__(self, flags: int = START_OF_EXPOSURE, driver: str = "fake") -> None:
        self.driver = driver
        self.path = "/dev/video0"
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self.flags = flags
        self.asked_buffers = 0
        self.controls = {"EXPOSURE_ABSOLUTE": 157, "GAIN": 4}
        self.calls: list[str] = []
        self.on_times_ns: list[int] = []
        self.queued: list[int] = []
        self.filled: list[v4l2.Buffer] = []
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
        self.filled.append(v4l2.Buffer(index, len(data), self.flags | flags, timestamp_ns, sequence, 0, 4096))
        os.eventfd_write(self.fd, 1)
        return timestamp_ns

    def unplug(self, code: int) -> None:
        self.dequeue_error = code
        os.eventfd_write(self.fd, 1)

    def close(self) -> None:
        self.calls.append("close")
        os.close(self.fd)
        self.fd = -1

    def capability(self) -> tuple[str, str, int]:
        return self.driver, "Fake camera", v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_STREAMING

    def control(self, control: str) -> int | None:
        return self.controls.get(control)

    def control_range(self, control: str) -> tuple[int, int] | None:
        return (1, 5000) if control in self.controls else None

    def set_control(self, control: str, value: int) -> None:
        self.controls[control] = value

    def request_buffers(self, count: int) -> int:
        self.asked_buffers = count
        return min(count, len(self._memory))

    def query_buffer(self, index: int) -> v4l2.Buffer:
        return v4l2.Buffer(index, 0, self.flags, 0, 0, index * 4096, 4096)

    def map(self, buffer: v4l2.Buffer) -> mmap.mmap:
        return self._memory[buffer.index]

    def queue(self, index: int) -> None:
        assert index not in self.queued, "the kernel answers EINVAL to a buffer that is queued already"
        self.queued.append(index)

    def dequeue(self) -> v4l2.Buffer:
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

    def sizes(self, fourcc: str) -> tuple[tuple[range, range], ...]:
        return ((range(640, 641), range(480, 481)),)

    def intervals(self, fourcc: str, width: int, height: int) -> tuple[tuple[Fraction, Fraction], ...]:
        return rates(30, 15)

    def set_format(self, fourcc: str, width: int, height: int) -> PixelFormat:
        return self._taken

    def set_period(self, period: Fraction) -> Fraction:
        return Fraction(1, self._rate)
