"""A machine-vision camera without a library, whose time a test has: as `device.AravisDevice`, in memory."""

import queue
import time
from collections.abc import Callable

from msgspec.structs import replace

from capture_app.common.camera_facts import (
    MICROSECONDS,
    CameraFacts,
    Control,
    ControlState,
    PhaseControl,
    TimestampSource,
)
from capture_app.common.errors import CameraError
from capture_app.plugins.cameras.aravis.aravis_device import AravisDevice, DeviceFrame

SETUP = CameraFacts(
    kind="aravis",
    model="Maker Model",
    width=4,
    height=2,
    pixel_format="Mono8",
    # So slow that a busy machine takes a frame before the next one would come.
    period_ns=1_000_000_000,
    timestamp_source=TimestampSource.UNKNOWN,
    phase_control=PhaseControl.FRAME_DURATION,
    min_frame_duration_ns=1_000_000,
    max_frame_duration_ns=10_000_000_000,
    exposure_ns=3_000_000,
    min_exposure_ns=10_000,
    max_exposure_ns=1_000_000_000,
)
PIXELS = bytes(range(8))


class FakeDevice(AravisDevice):
    """Gives the frames that a test puts in, and keeps what it was asked for."""

    address = "fake"

    def __init__(self, *, counter_offset_ns: int | None = 0) -> None:
        """`counter_offset_ns`: the counter minus the host's clock; None where it cannot be read."""
        self.facts = SETUP
        self._offset_ns = counter_offset_ns
        self._frames: queue.Queue[DeviceFrame] = queue.Queue()
        self.periods_ns: list[int] = []
        self.closed = False
        self.refuses = False
        self.lose: Callable[[], None]

    def put(self, number: int, *, counter_ns: int | None = None, whole: bool = True) -> int:
        """Let a frame arrive now that began 8 ms ago; return when it began by the host's clock."""
        now_ns = time.monotonic_ns()
        begun_ns = now_ns - 8_000_000
        told_ns = begun_ns + (self._offset_ns or 0) if counter_ns is None else counter_ns
        self._frames.put(DeviceFrame(number, told_ns, now_ns, PIXELS if whole else None))
        return begun_ns

    def read_counter(self) -> tuple[int, int, int] | None:
        if self._offset_ns is None:
            return None
        now_ns = time.monotonic_ns()
        return now_ns - 1000, now_ns + self._offset_ns, now_ns + 1000

    def controls(self) -> tuple[ControlState, ...]:
        exposure_us = None if self.facts.exposure_ns is None else self.facts.exposure_ns / 1000
        return (ControlState(control=Control.EXPOSURE, unit=MICROSECONDS, value=exposure_us),)

    def set_control(self, control: Control, value: float | None) -> None:
        self.facts = replace(self.facts, exposure_ns=None if value is None else round(value * 1000))

    def set_period(self, period_ns: int) -> None:
        if self.refuses:
            raise CameraError("fake does not answer any more")
        self.periods_ns.append(period_ns)

    def start(self, on_lost: Callable[[], None]) -> None:
        self.lose = on_lost

    def next_frame(self, timeout_s: float) -> DeviceFrame | None:
        try:
            return self._frames.get(timeout=max(timeout_s, 0.001))
        except queue.Empty:
            return None

    def close(self) -> None:
        self.closed = True
