"""What the client node adds to the engine: cameras that fail and come back, restarts that keep their aim."""

import asyncio
import contextlib
import errno
from collections.abc import AsyncIterator, Iterable
from typing import Any, cast

import pytest
from msgspec.structs import replace

from capture_app.cameras.frames import CapturedFrame
from capture_app.common import host_clock
from capture_app.common.camera_facts import Control
from capture_app.common.errors import CameraError
from capture_app.node.camera import supervisor
from capture_app.node.camera.supervisor import CameraSupervisor, NodeOptions
from capture_app.plugins.cameras.v4l2.v4l2_driver import V4L2Camera
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream
from tests.unit.cameras.fake_camera import FACTS, PERIOD_NS, FakeCamera, frame
from tests.unit.plugins.cameras.v4l2.fake_device import MJPG, FakeDevice


class StoppedClock:
    """The node's clock, moved by the test alone."""

    ns = 1_000_000_000
    local_from_true = true_from_local = staticmethod(lambda ns: ns)

    def now_ns(self) -> int:
        return self.ns


class Bench:
    """A camera under supervision, with its devices, clock and engine in the test's hands."""

    def __init__(self, label: str = "") -> None:
        self.opened: asyncio.Queue[FakeCamera] = asyncio.Queue()
        self.next_facts = FACTS
        self.clock = StoppedClock()
        self.stamps: list[FrameStamp] = []
        self.batches: list[list[FrameStamp]] = []
        self.starts_ns: list[int] = []
        self.failures: list[str] = []
        self.slept: list[tuple[int, int]] = []
        self.wanted: list[CameraCommand] = []
        options = NodeOptions(name="cam", label=label, open_camera=self._open, leaders=(), clock=self.clock)
        self.supervisor = CameraSupervisor(options, retry_s=0.0)

    async def start(self) -> None:
        await self.supervisor.open()
        self.supervisor.connect(cast(Any, self), cast(Any, self))

    async def next_camera(self) -> FakeCamera:
        return await asyncio.wait_for(self.opened.get(), 30)

    def _open(self) -> FakeCamera:
        camera = FakeCamera(self.next_facts)
        self.opened.put_nowait(camera)
        return camera

    # As the pump

    def turn(self) -> None:
        self.supervisor.collect_commands()

    # As the engine

    def wake_up(self, slept_ns: int, now_ns: int) -> None:
        self.slept.append((slept_ns, len(self.batches)))

    has_burst_pending = False

    def frames_arrived(self, frames: Iterable[tuple[FrameStamp, CapturedFrame, int]], now_ns: int) -> None:
        self.batches.append([stamp for stamp, _, _ in frames])
        self.stamps += self.batches[-1]

    def stream_started(self, now_ns: int) -> None:
        self.starts_ns.append(now_ns)

    def fail(self, reason: str) -> None:
        self.failures.append(reason)

    def next_command(self) -> CameraCommand | None:
        if not self.wanted:
            return None
        self.clock.ns += 8_000_000
        return self.wanted.pop()


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    bench = Bench()
    await bench.start()
    running = asyncio.gather(bench.supervisor.keep_open(), bench.supervisor.carry_out_commands())
    yield bench
    running.cancel()
    with contextlib.suppress(asyncio.CancelledError, CameraError):
        await running


async def started(camera: FakeCamera) -> None:
    """Let the node go on until it has started this camera and serves it."""
    while not hasattr(camera, "on_frame"):  # noqa: ASYNC110
        await asyncio.sleep(0.001)
    await asyncio.sleep(0.01)


async def test_a_camera_opened_again_goes_on_counting_streams(bench: Bench) -> None:
    first = await bench.next_camera()
    await started(first)
    for stream in (1, 2, 3):
        first.on_frame(frame(stream))
    bench.next_facts = replace(FACTS, exposure_ns=20_000_000)
    first.on_failure(CameraError("unplugged"))
    second = await bench.next_camera()
    await started(second)
    second.on_frame(frame(0))
    await asyncio.sleep(0)
    assert [len(batch) for batch in bench.batches] == [3, 1], "what arrives together is passed on together"
    streams = [stamp.stream for stamp in bench.stamps]
    assert streams == sorted(set(streams))
    assert len(streams) == 4
    assert bench.failures == ["unplugged", ""]
    assert (first.is_stopped, second.is_stopped) == (True, False), "the device may be opened once"


async def test_what_an_operator_has_set_is_set_again_on_a_camera_that_comes_back(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    has_set = list[tuple[FakeCamera, Control, float | None]]()

    async def set_control(camera: FakeCamera, control: Control, value: float | None) -> None:
        has_set.append((camera, control, value))

    monkeypatch.setattr(FakeCamera, "set_control", set_control)
    first = await bench.next_camera()
    await started(first)
    bench.supervisor.controls.held[Control.GAIN] = 3.0
    first.on_failure(CameraError("unplugged"))
    second = await bench.next_camera()
    await started(second)
    assert has_set == [(second, Control.GAIN, 3.0)]


async def test_a_camera_that_does_not_start_is_released() -> None:
    device = FakeDevice()
    device.stream_on_error = errno.ENOSPC
    bench = Bench()
    bench.supervisor = CameraSupervisor(
        NodeOptions(
            name="cam", open_camera=lambda: V4L2Camera(device, MJPG, PERIOD_NS), leaders=(), clock=bench.clock
        )
    )
    with pytest.raises(CameraError, match="bandwidth"):
        await bench.supervisor.open()
    assert device.calls[-1] == "close", "else the next try finds it in use"


async def test_another_camera_in_its_place_is_an_error() -> None:
    bench = Bench()
    await bench.start()
    first = await bench.next_camera()
    bench.next_facts = replace(FACTS, model="Another camera")
    first.on_failure(CameraError("unplugged"))
    with pytest.raises(CameraError, match="another camera is connected now: Another camera"):
        await asyncio.wait_for(bench.supervisor.keep_open(), 30)


@pytest.mark.parametrize(
    ("delay_ns", "given_ns"), [(20_000_000, 12_000_000), (5_000_000, PERIOD_NS - 3_000_000)]
)
async def test_a_restart_keeps_its_aim_though_the_engine_took_8_ms(
    bench: Bench, delay_ns: int, given_ns: int
) -> None:
    camera = await bench.next_camera()
    await started(camera)
    frame_ns = bench.clock.ns
    bench.wanted = [RestartStream(delay_ns)]
    camera.on_frame(frame(1))
    assert await asyncio.wait_for(camera.commands.get(), 30) == RestartStream(given_ns)
    await asyncio.sleep(0)
    assert (bench.starts_ns[-1] - frame_ns - delay_ns) % PERIOD_NS == 0


async def test_a_camera_that_falls_silent_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A webcam whose driver says nothing stayed "aligning" for ever."""
    monkeypatch.setattr(supervisor, "SILENCE_TICK_S", 0.01)
    monkeypatch.setattr(supervisor, "SILENT_PERIODS", 0)
    bench = Bench()
    await bench.start()
    running = asyncio.create_task(bench.supervisor.keep_open())
    first = await bench.next_camera()
    for stream in range(1, 40):
        first.on_frame(frame(stream))
        await asyncio.sleep(0.005)
    assert bench.opened.empty()
    await started(await bench.next_camera())
    assert bench.failures == ["it delivers no frames any more (check its cable)", ""]
    running.cancel()


@pytest.mark.virtual
async def test_a_camera_that_pauses_now_and_then_is_not_opened_again() -> None:
    bench = Bench()
    await bench.start()
    camera = await bench.next_camera()
    failing = asyncio.create_task(bench.supervisor._next_failure())
    for stream in range(10):
        camera.on_frame(frame(stream))
        await asyncio.sleep(3.0)
    assert not failing.done()
    failing.cancel()


async def test_a_sleep_is_noticed_before_the_frames_after_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = await bench.next_camera()
    await started(first)
    before_ns = host_clock.slept_ns()
    for number, slept_ns in enumerate((0, 3_000_000_000, 3_000_000_000)):
        monkeypatch.setattr(host_clock, "slept_ns", lambda ns=slept_ns: ns + before_ns)
        first.on_frame(frame(number))
        await asyncio.sleep(0)
    assert bench.slept == [(3_000_000_000, 1)], "after a batch of frames, and before the next one"


async def test_what_its_owner_calls_it_is_among_its_facts() -> None:
    bench = Bench(label="カメラ左")
    await bench.start()
    assert bench.supervisor.facts.label == "カメラ左"
    await bench.supervisor.camera.stop()
