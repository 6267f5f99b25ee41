"""Interface of camera drivers, and the base of cameras whose drivers block."""

import asyncio
import contextlib
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Protocol, Self, TypeVar

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.camera_facts import CameraFacts, CameraListing, Control, ControlState
from capture_app.common.clock import HostClock, NodeClock
from capture_app.common.errors import CameraError
from capture_app.common.host_clock import host_from_monotonic
from capture_app.session.format.calibration import CameraCalibration
from capture_app.sync.wire.camera_commands import CameraCommand

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """Accuracy of the mapping from a device's own clock to the host's; times in ns."""

    uncertainty_ns: int
    """Uncertainty at 95 %."""
    hard_bound_ns: int


@dataclass(frozen=True, slots=True)
class SwitchedControl:
    """A driver's names for a control's value and for the switch that makes it automatic."""

    value: str
    unit: str | None
    """None for steps of that model."""
    switch: str
    manual: int = 0
    """Value of the switch for a fixed value."""
    automatic: tuple[int, ...] = (1,)
    """Its values for an automatic one, preferred first; the first that the driver accepts is used."""
    scale: float = 1.0
    """Size of one step of the value, in `unit`."""
    together: tuple[str, ...] = ()
    """Other values that the same switch governs, or that contradict this one."""


OnFrame = Callable[[CapturedFrame], None]
OnFailure = Callable[[Exception], None]


class Camera(ABC):
    """A camera driver. All methods are called on the event loop and must not block it."""

    _clock_of_node: NodeClock = HostClock()
    _facts: CameraFacts | None = None
    _on_frame: OnFrame
    _on_failure: OnFailure

    def in_clock(self, clock: NodeClock) -> Self:
        """Make the camera stamp frames in a node's clock instead of the host's, from its start; return it."""
        self._clock_of_node = clock
        return self

    def listen(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Store the callbacks for frames, which drivers stamp in CLOCK_MONOTONIC, and for a failure."""
        self._on_failure, clock = on_failure, self._clock_of_node
        self._on_frame = lambda frame: on_frame(
            replace(frame, timestamp_ns=clock.local_from_true(host_from_monotonic(frame.timestamp_ns)))
        )

    @property
    def facts(self) -> CameraFacts:
        """Properties and capabilities of this camera; known once it has started, mostly once it is open.

        Raises CameraError before that.
        """
        if self._facts is None:
            raise CameraError(
                "the facts of this camera are not known before it starts", hint="call start() first"
            )
        return self._facts

    @property
    def calibration(self) -> CameraCalibration | None:
        """Intrinsics and pose if they are known exactly, as for a rendered view; else None."""
        return None

    @property
    def device_clock(self) -> DeviceClock | None:
        """Accuracy of the device's own clock against the host's; None if it stamps in the host's clock."""
        return None

    @abstractmethod
    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start streaming; `on_frame` is called on the event loop for each frame in order.

        `on_failure` is called once if the device disconnects while streaming.
        Raises CameraError if the device is missing, busy or refuses its settings.
        """

    @abstractmethod
    async def apply(self, command: CameraCommand) -> None:
        """Send a phase command; return once the device has accepted it, not when it takes effect."""

    async def controls(self) -> tuple[ControlState, ...]:
        """Return the current exposure, gain, white balance and focus, as far as this camera has them."""
        return ()

    async def set_control(self, control: Control, value: float | None) -> None:  # noqa: B027 - none to set
        """Set a control, in its unit, to a fixed value; None lets the camera choose it.

        It is one of `controls`; the value is within its limits, or None where it can be automatic. The
        exposure in `facts` may change. Raises CameraError or OSError if the camera does not take it.
        """

    @abstractmethod
    async def stop(self) -> None:
        """Stop streaming and release the device. Calling it twice is harmless."""


def wait_for_start(early_ns: int, period_ns: int, closing: threading.Event) -> bool:
    """Block until a start that is due in `early_ns`; if it has passed, until whole periods after it.

    Return False if `closing` was set first.
    """
    return not closing.wait((early_ns if early_ns > 0 else early_ns % period_ns) / 1e9)


def buffer_count(frame_bytes: int, period_ns: int, *, max_count: int, max_bytes: int) -> int:
    """Return how many buffers a stream needs, 4 to `max_count`, so that a process may be delayed by 0.5 s.

    Fewer if they would take more than `max_bytes`.
    """
    return max(4, min(max_count, max_bytes // max(1, frame_bytes), -(-500_000_000 // period_ns)))


class CameraDriver(Protocol):
    """A plugin of the group `simulshot.cameras`, usually a module; its entry point names the kind."""

    SPEC: str
    """Syntax of a spec of this kind, such as `v4l2:/dev/videoN[,key=value…]`."""
    HELP: str
    """One-line description of the cameras that this driver supports."""
    NEEDS: str
    """The extra or system package that must be installed; empty if none is needed."""
    OPTIONS: Mapping[str, str]
    """Description of each option of a spec; a spec with any other option is refused before `open_camera`."""

    def open_camera(self, device: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
        """Open a camera for the node `name`, its timestamps in that node's clock.

        Raises BadInputError for an option that cannot be read, CameraError for a camera that is missing or
        refuses, NotAvailableError if this machine lacks something that the driver needs.
        """

    def list_cameras(self) -> list[CameraListing]:
        """Return the cameras of this machine, including unusable ones; empty if the driver cannot list any.

        It does not fail if a package that the driver needs is not installed.
        """


class ThreadedCamera(Camera):
    """A camera with its own worker, so that a busy default executor never delays its calls."""

    _loop: asyncio.AbstractEventLoop
    _begun: asyncio.Future[None]
    """Done when the camera streams; has an exception if its start has failed."""
    _was_started = _has_failed = False

    def __init__(self, name: str, worker: Executor | None = None) -> None:
        """Create the worker; its threads are named `name`."""
        self._worker = worker or ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._closing = threading.Event()

    def listen(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Store the callbacks and the running loop that calls them. Raises CameraError the second time."""
        if self._closing.is_set() or self._was_started:
            raise CameraError("the camera was started already", hint="open it again")
        self._loop, self._was_started = asyncio.get_running_loop(), True
        self._begun = self._loop.create_future()
        super().listen(on_frame, on_failure)

    async def stop(self) -> None:
        """Stop streaming and release the device. Calling it twice is harmless."""
        if not self._closing.is_set():
            self._closing.set()
            await self._let_go()
            self._worker.shutdown(wait=False)

    @abstractmethod
    async def _let_go(self) -> None:
        """Release what the camera holds; `_closing` is set by then."""

    def _in_worker(self, work: Callable[..., T], *arguments: object) -> "asyncio.Future[T]":
        return asyncio.get_running_loop().run_in_executor(self._worker, work, *arguments)

    def _call_in_loop(self, callback: Callable[..., object], *what: object) -> None:
        """Have the loop call `callback`; safe from any thread."""
        with contextlib.suppress(RuntimeError):  # the loop is closed: the process ends
            self._loop.call_soon_threadsafe(callback, *what)

    def _deliver(self, frame: CapturedFrame) -> None:
        if not self._closing.is_set():
            self._on_frame(frame)

    def _fail(self, error: CameraError) -> None:
        """End a start with this error, or report the failure of a stream, once and not after its stop."""
        if not self._begun.done():
            self._begun.set_exception(error)
        elif not (self._has_failed or self._closing.is_set()):
            self._on_failure(error)
        self._has_failed = True
