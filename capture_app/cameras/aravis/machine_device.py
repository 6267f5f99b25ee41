"""What a camera's stream asks of the device behind it, and what the device tells."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from capture_app.camera_controls import Control, ControlState


@dataclass(frozen=True, slots=True)
class DeviceSetup:
    """How a camera is set up; times in ns."""

    model: str
    width: int
    height: int
    pixel_format: str
    period_ns: int
    durations_ns: tuple[int, int] | None
    """Shortest and longest duration of a frame; None where it cannot be set."""
    exposure_ns: int | None
    exposures_ns: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class DeviceFrame:
    """One frame as the library delivered it."""

    number: int
    """Of the transport: 16 bits without 0, or more."""
    counter_ns: int
    """The camera's stamp, by its own counter."""
    arrival_ns: int
    """When its first packet came, by the host's monotonic clock."""
    data: bytes | None
    """None where packets of it are missing."""


class MachineDevice(Protocol):
    """A connected camera, as `device.AravisDevice` is; every call blocks."""

    address: str
    setup: DeviceSetup

    def read_counter(self) -> tuple[int, int, int] | None:
        """Host time before, counter, host time after, in ns; None where the counter cannot be read."""

    def set_period(self, period_ns: int) -> None:
        """Let frames last so long from now on. Raises CameraError."""

    def controls(self) -> tuple[ControlState, ...]:
        """Exposure and gain as they stand. Raises CameraError."""

    def set_control(self, control: Control, value: float | None) -> None:
        """Set a control and hold it there; None: let the camera choose. Raises CameraError."""

    def start(self, on_lost: Callable[[], None]) -> None:
        """Let frames come; `on_lost` is called from any thread. Raises CameraError."""

    def next_frame(self, timeout_s: float) -> DeviceFrame | None:
        """Wait for a frame, for so long at most."""

    def close(self) -> None:
        """Let go of the camera."""
