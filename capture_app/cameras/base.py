"""What a camera is to a node: a stream of timestamped frames, and at best a way to move its phase."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, Self

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.camera_facts import CameraFacts, CameraListing, Control, ControlState
from capture_app.common.clock import HostClock, NodeClock
from capture_app.common.errors import CameraError
from capture_app.session.format.calibration import CameraCalibration
from capture_app.sync.wire.camera_commands import CameraCommand


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """How well the clock that a device stamps by is known in the host's; times in ns."""

    uncertainty_ns: int
    """95 %."""
    hard_bound_ns: int


OnFrame = Callable[[CapturedFrame], None]
OnFailure = Callable[[Exception], None]


class Camera(ABC):
    """A camera driver. All methods are called on the event loop and must not block it."""

    _clock_of_node: NodeClock = HostClock()
    _facts: CameraFacts | None = None
    _on_frame: OnFrame
    _on_failure: OnFailure

    def in_clock(self, clock: NodeClock) -> Self:
        """Return the camera; from its start on it stamps frames in a node's clock instead of the host's."""
        self._clock_of_node = clock
        return self

    def listen(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Keep whom a driver tells of its frames, stamped in the host's clock, and of its failure."""
        self._on_frame, self._on_failure, clock = on_frame, on_failure, self._clock_of_node
        if not isinstance(clock, HostClock):
            self._on_frame = lambda frame: on_frame(
                replace(frame, timestamp_ns=clock.local_from_true(frame.timestamp_ns))
            )

    @property
    def facts(self) -> CameraFacts:
        """What this camera is and can do, known once it has started, mostly as soon as it is open.

        Raises CameraError before that.
        """
        if self._facts is None:
            raise CameraError("this camera is known when it was started")
        return self._facts

    @property
    def calibration(self) -> CameraCalibration | None:
        """Intrinsics and pose where they are known by construction, as those of a rendered view are."""
        return None

    @property
    def device_clock(self) -> DeviceClock | None:
        """The clock that the device itself stamps by against the host's; None where that is the host's."""
        return None

    @abstractmethod
    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start streaming; `on_frame` is called on the event loop for each frame in order.

        `on_failure` is called once if the device goes away while streaming.
        Raises CameraError where the device is missing, busy or refuses its settings.
        """

    @abstractmethod
    async def apply(self, command: CameraCommand) -> None:
        """Carry out a phase command; returns when the device has taken it, not when it took effect."""

    async def controls(self) -> tuple[ControlState, ...]:
        """Exposure, gain, white balance and focus as they stand; those that this camera has."""
        return ()

    async def set_control(self, control: Control, value: float | None) -> None:
        """Set a control, in its unit, and hold it there; None: let the camera choose it.

        `facts` may tell another exposure afterwards. Raises CameraError where it cannot.
        """
        raise CameraError(f"a {self.facts.kind} camera has no control of its {control}")

    @abstractmethod
    async def stop(self) -> None:
        """Stop streaming and let go of the device. Calling it twice is harmless."""


def wait_for_start(
    start_ns: int, period_ns: int, closing: threading.Event, now_ns: Callable[[], int]
) -> bool:
    """Block until that clock's time in ns, or whole periods after it where it is over; False once closing."""
    late_ns = now_ns() - start_ns
    if late_ns > 0:
        start_ns += -(-late_ns // period_ns) * period_ns
    return not closing.wait((start_ns - now_ns()) / 1e9)


class CameraDriver(Protocol):
    """A plugin of the group `simulshot.cameras`, mostly a module; its entry point names the kind."""

    SPEC: str
    """How a spec of this kind is written, as `webcam:NUMBER[,key=value…]`."""
    HELP: str
    """Which cameras these are, in one line."""
    NEEDS: str
    """The extra or system package that must be installed; empty where none is."""
    OPTIONS: Mapping[str, str]
    """The options of a spec, and what each means; a spec with any other is refused before `open_camera`."""

    def open_camera(self, device: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
        """Open a camera for the node `name`, its timestamps in that node's clock.

        Raises BadInputError for an option that cannot be read, CameraError for a camera that is missing or
        refuses, NotAvailableError for what this machine does not have.
        """

    def list_cameras(self) -> list[CameraListing]:
        """Return the cameras of this machine, also those that cannot be used; none where they have no list.

        It does not fail where what the driver needs is not installed.
        """
