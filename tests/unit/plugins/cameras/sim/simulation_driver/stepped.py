"""Simulated cameras on an event loop whose time the test has."""

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from capture_app.cameras.base import Camera
from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import open_camera
from capture_app.common.clock import SimulatedClock

P = ParamSpec("P")
T = TypeVar("T")

PERIOD_NS = 33_333_000
HOUR_NS = 3_600_000_000_000


class SteppedSelector(selectors.DefaultSelector):
    """Waits for nothing, and counts the seconds that it should have waited."""

    now_s = 1000.0

    def select(self, timeout: float | None = None) -> Any:
        if ready := super().select(0):
            return ready
        assert timeout is not None, "the test waits for something that never comes"
        self.now_s += timeout
        return []


class SteppedLoop(asyncio.SelectorEventLoop):
    """An event loop whose time jumps to the next timer, so that seconds of streaming take milliseconds."""

    def __init__(self) -> None:
        self.selector = SteppedSelector()
        super().__init__(self.selector)

    def time(self) -> float:
        return self.selector.now_s


class LoopClock(SimulatedClock, frozen=True):
    """A clock in the loop's time, which is true time here."""

    def now_ns(self) -> int:
        return self.local_from_true(true_now_ns())


def true_now_ns() -> int:
    return round(asyncio.get_running_loop().time() * 1e9)


def in_stepped_time(scenario: Callable[P, Coroutine[Any, Any, T]]) -> Callable[P, T]:
    """Let a coroutine run on a stepped loop of its own."""

    @wraps(scenario)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        with asyncio.Runner(loop_factory=SteppedLoop) as runner:
            return runner.run(scenario(*args, **kwargs))

    return run


def sim(spec: str, name: str = "cam00") -> Camera:
    return open_camera(spec, clock=LoopClock(2 * HOUR_NS), name=name)


class Recorder:
    """Keeps what a camera delivers, and when in true time."""

    def __init__(self) -> None:
        self.frames: list[CapturedFrame] = []
        self.arrivals_true_ns: list[int] = []
        self.failures: list[Exception] = []

    def on_frame(self, frame: CapturedFrame) -> None:
        self.frames.append(frame)
        self.arrivals_true_ns.append(true_now_ns())

    async def record(self, camera: Camera, seconds: float) -> list[CapturedFrame]:
        await camera.start(self.on_frame, self.failures.append)
        await asyncio.sleep(seconds)
        return self.frames


def starts(frames: list[CapturedFrame]) -> list[int]:
    assert all(frame.true_ns is not None for frame in frames)
    return [frame.true_ns for frame in frames if frame.true_ns is not None]


async def frames_of(camera: Camera, seconds: float) -> list[CapturedFrame]:
    """Let a camera stream for so long; return what it delivered."""
    frames = await Recorder().record(camera, seconds)
    await camera.stop()
    return frames
