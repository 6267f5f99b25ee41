"""One camera of the double: a sensor, and the requests that its frames fill."""

import asyncio
import random
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from types import SimpleNamespace
from typing import Any

LATENCY_FRAMES = 2
PLANES = ((0, 64 * 48), (64 * 48, 64 * 24))


class ControlId:
    def __init__(self, name: str, vendor: str = "libcamera") -> None:
        self.name, self.vendor = name, vendor


NAMES = (
    "FrameDurationLimits FrameDuration SensorTimestamp ExposureTime AeEnable AnalogueGain"
    " AwbEnable ColourGains"
)
IDS = {name: ControlId(name) for name in NAMES.split()} | {
    "StatsOutputEnable": ControlId("StatsOutputEnable", "rpi")
}
AUTO = IDS["AeEnable"]
MODEL, SIZE, DEVICES = ControlId("Model"), ControlId("PixelArraySize"), ControlId("SystemDevices")


class Status(Enum):
    Pending, Complete, Cancelled = range(3)


class FrameStatus(Enum):
    Success, Error, Cancelled = range(3)


class ConfigurationStatus(Enum):
    Valid, Adjusted, Invalid = range(3)


@dataclass
class Size:
    width: int
    height: int


class PixelFormat(str):
    pass


@dataclass
class Sensor:
    """One sensor and its mode; times in ns of its own crystal, which is off by `ppm`."""

    row_ns: float = 18_903.7
    ppm: float = 0.0
    noise_ns: int = 1_000
    """Standard deviation of its stamps."""
    shortest_us: int = 15_000
    longest_us: int = 11_767_000
    exposure_us: int = 9_000
    """Where automatic exposure settles."""
    rounds: bool = False
    """Whether durations are told rounded, not cut."""
    model: str = "imx219"
    seed: int = 0


class Request:
    def __init__(self, cookie: int) -> None:
        self.cookie = cookie
        self.status = Status.Pending
        self.metadata: dict[ControlId, Any] = {}
        self.settings: dict[ControlId, Any] = {}
        self.buffer: Any = None

    def add_buffer(self, stream: Any, buffer: Any) -> None:
        self.buffer = buffer

    def set_control(self, control: ControlId, value: Any) -> None:
        assert self.status is Status.Pending, "a request that is queued takes no settings"
        self.settings[control] = value

    def reuse(self) -> None:
        self.status, self.metadata, self.settings = Status.Pending, {}, {}


@dataclass
class Frame:
    """The truth of one frame, in ns of the loop's time."""

    stream: int
    sequence: int
    exposed_from_ns: int
    readout_ns: int


@dataclass
class Camera:
    manager: Any
    id: str
    sensor: Sensor
    frames: list[Frame] = field(default_factory=list)
    """Those delivered since the test last looked."""
    lost: int = 0
    starts: int = 0
    acquired: bool = False
    dead: bool = False

    def __post_init__(self) -> None:
        sensor = self.sensor
        self.properties = {MODEL: sensor.model, SIZE: Size(3280, 2464)}
        self.controls = {control: SimpleNamespace(min=0, max=1) for control in IDS.values()}
        self.controls[IDS["FrameDurationLimits"]] = SimpleNamespace(
            min=sensor.shortest_us, max=sensor.longest_us
        )
        self.controls[IDS["ExposureTime"]] = SimpleNamespace(min=29, max=1_000_000)
        self.controls[IDS["AnalogueGain"]] = SimpleNamespace(min=1.0, max=10.7)
        self._rng = random.Random(sensor.seed)
        self._queue: deque[Request] = deque()
        self._under_way: list[Request] = []
        self._next: asyncio.TimerHandle | None = None
        self._settings: dict[ControlId, Any] = {}

    def acquire(self) -> None:
        if self.acquired:
            raise RuntimeError("Device or resource busy")
        self.acquired = True

    def release(self) -> None:
        assert self._next is None, "released while it streams"
        self.acquired = False

    def generate_configuration(self, roles: list[Any]) -> Any:
        formats = SimpleNamespace(
            pixel_formats=[PixelFormat("XRGB8888"), PixelFormat("YUYV"), PixelFormat("NV12")]
        )
        stream = SimpleNamespace(
            formats=formats, buffer_count=4, stream="stream", stride=64, frame_size=64 * 72
        )
        return SimpleNamespace(size=1, at=lambda _: stream, validate=lambda: self._validate(stream))

    def _validate(self, stream: Any) -> ConfigurationStatus:
        stream.size = Size(64, 48)
        self.buffer_count = stream.buffer_count
        return ConfigurationStatus.Adjusted

    def configure(self, configuration: Any) -> None:
        assert self.acquired
        self._loop, self._thread = asyncio.get_running_loop(), threading.get_ident()

    def create_request(self, cookie: int) -> Request:
        return Request(cookie)

    def start(self, settings: dict[ControlId, Any]) -> None:
        self._on_loop(self._start, settings)

    def stop(self) -> None:
        self._on_loop(self._stop)

    def queue_request(self, request: Request) -> None:
        assert request.status is Status.Pending, "a request must be reused first"
        assert request.buffer is not None
        self._queue.append(request)

    # The sensor

    def _on_loop(self, work: Callable[..., None], *arguments: Any) -> None:
        """Do it on the loop whose time it is, also where a thread asks."""
        if threading.get_ident() == self._thread:
            work(*arguments)
            return

        async def do() -> None:
            work(*arguments)

        asyncio.run_coroutine_threadsafe(do(), self._loop).result()

    def _start(self, settings: dict[ControlId, Any]) -> None:
        self.starts += 1
        self._settings = dict(settings)
        self._sequence = 0
        exposure_us = self._settings.get(IDS["ExposureTime"], 20_000)
        self._coming = deque([(self._rows(), exposure_us)] * LATENCY_FRAMES)
        self._frame_ns = round((self._loop.time() + 0.2 + self._rng.random() / 30) * 1e9)
        self._expect()

    def _stop(self) -> None:
        if self._next is not None:
            self._next.cancel()
        self._next = None
        for request in (*self._under_way, *self._queue):
            request.status = Status.Cancelled
            self.manager.finish(request)
        self._under_way.clear()
        self._queue.clear()

    def _rows(self) -> int:
        limits = self._settings.get(IDS["FrameDurationLimits"], (33_333, 33_333))
        duration_us = min(max(limits[0], self.sensor.shortest_us), self.sensor.longest_us)
        return int(duration_us * 1000 / self.sensor.row_ns)

    def _exposure_us(self) -> int:
        if not self._settings.get(AUTO, True):
            return self._settings[IDS["ExposureTime"]]
        return round(self.sensor.exposure_us * (1.0 + 1.0 / (1 + self._sequence)))

    def _expect(self) -> None:
        if not self.dead:
            self._next = self._loop.call_at(self._frame_ns / 1e9, self._begin_frame)

    def _begin_frame(self) -> None:
        """A frame is read out: its request's settings are taken in, for the frame after the next."""
        request = self._queue.popleft() if self._queue else None
        if request is not None:
            self._settings |= request.settings
            self._under_way.append(request)
        self._coming.append((self._rows(), self._exposure_us()))
        rows, exposure_us = self._coming.popleft()
        exposed_rows = int(exposure_us * 1000 / self.sensor.row_ns)
        if request is None:
            self.lost += 1
        else:
            exposed_ns = round(exposed_rows * self.sensor.row_ns)
            stamp_ns = self._frame_ns + round(self._rng.gauss(0.0, self.sensor.noise_ns))
            values = {
                "SensorTimestamp": stamp_ns,
                "FrameDuration": self._told_us(rows),
                "ExposureTime": self._told_us(exposed_rows),
                "AnalogueGain": 2.0
                if self._settings.get(AUTO, True)
                else self._settings[IDS["AnalogueGain"]],
                "ColourGains": (1.5, 1.25),
            }
            frame = Frame(self.starts, self._sequence, self._frame_ns - exposed_ns, self._frame_ns)
            self._loop.call_at(self._frame_ns / 1e9 + 0.02, self._finish, request, frame, values)
        self._sequence += 1
        self._frame_ns += round(rows * self.sensor.row_ns * (1.0 + self.sensor.ppm * 1e-6))
        self._expect()

    def _told_us(self, rows: int) -> int:
        exact_us = rows * self.sensor.row_ns / 1000
        return round(exact_us) if self.sensor.rounds else int(exact_us)

    def _finish(self, request: Request, frame: Frame, values: dict[str, Any]) -> None:
        if request not in self._under_way:
            return
        self._under_way.remove(request)
        self.frames.append(frame)
        request.metadata = {IDS[name]: value for name, value in values.items()}
        planes = [SimpleNamespace(bytes_used=length) for _, length in PLANES]
        request.buffer.metadata = SimpleNamespace(
            sequence=frame.sequence,
            timestamp=values["SensorTimestamp"],
            status=FrameStatus.Success,
            planes=planes,
        )
        request.status = Status.Complete
        self.manager.finish(request)
