"""What the client node adds to the engine: cameras that fail and come back, restarts that keep their aim."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest
from msgspec.structs import replace

from capture_app.camera_facts import CameraFacts, PhaseControl
from capture_app.cameras.base import (
    Camera,
    CapturedFrame,
    OnFailure,
    OnFrame,
)
from capture_app.errors import CameraError
from capture_app.net.address import Address
from capture_app.node.camera import client as client_module
from capture_app.node.camera.client import ClientNode
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.rig.client import Client
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream
from tests.facts import make_facts

PERIOD_NS = 33_333_333
FACTS = make_facts(
    kind="fake",
    model="Fake camera",
    pixel_format="MJPG",
    period_ns=PERIOD_NS,
    phase_control=PhaseControl.RESET,
    exposure_ns=10_000_000,
)


class FakeCamera(Camera):
    """A camera whose frames and failures come from the test."""

    def __init__(self, facts: CameraFacts = FACTS) -> None:
        self._facts = facts
        self.on_frame: OnFrame
        self.on_failure: OnFailure
        self.commands: asyncio.Queue[CameraCommand] = asyncio.Queue()

    @property
    def facts(self) -> CameraFacts:
        return self._facts

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        self.on_frame, self.on_failure = on_frame, on_failure

    async def apply(self, command: CameraCommand) -> None:
        self.commands.put_nowait(command)

    async def stop(self) -> None:
        pass


class Bench:
    """A node that runs for a test, with the cameras it opened, clock and engine in the test's hands."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.opened: asyncio.Queue[FakeCamera] = asyncio.Queue()
        self.next_facts = FACTS
        self.now_ns = 1_000_000_000
        self.stamps: list[FrameStamp] = []
        self.starts_ns: list[int] = []
        self.wanted: list[CameraCommand] = []
        monkeypatch.setattr(client_module, "CAMERA_RETRY_S", 0.0)
        monkeypatch.setattr(Client, "frame_arrived", lambda _, stamp, *__: self.stamps.append(stamp))
        monkeypatch.setattr(Client, "stream_started", lambda _, now_ns: self.starts_ns.append(now_ns))
        monkeypatch.setattr(Client, "next_command", lambda _: self._next_command())
        self.node = ClientNode(
            name="cam", open_camera=self._open, leader=Address("127.0.0.1", 9), clock=StoppedClock(self)
        )

    async def camera(self) -> FakeCamera:
        return await asyncio.wait_for(self.opened.get(), 30)

    def _open(self) -> FakeCamera:
        camera = FakeCamera(self.next_facts)
        self.opened.put_nowait(camera)
        return camera

    def _next_command(self) -> CameraCommand | None:
        if not self.wanted:
            return None
        self.now_ns += 8_000_000
        return self.wanted.pop()


class StoppedClock:
    """The node's clock, moved by the test alone."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def now_ns(self) -> int:
        return self._bench.now_ns

    def local_from_true(self, true_ns: int) -> int:
        return true_ns

    def true_from_local(self, local_ns: int) -> int:
        return local_ns


@pytest.fixture
async def bench(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Bench]:
    bench = Bench(monkeypatch)
    running = asyncio.ensure_future(bench.node.run())
    yield bench
    running.cancel()
    with contextlib.suppress(asyncio.CancelledError, ExceptionGroup):
        await running


def frame(stream: int) -> CapturedFrame:
    return CapturedFrame(sequence=0, stream=stream, timestamp_ns=0, payload=NoPayload())


class NoPayload:
    def encode(self) -> bytes:
        raise AssertionError


async def started(camera: FakeCamera) -> None:
    """Let the node go on until it has started this camera and serves it."""
    while not hasattr(camera, "on_frame"):  # noqa: ASYNC110
        await asyncio.sleep(0.001)
    await asyncio.sleep(0.01)


async def test_a_camera_opened_again_goes_on_counting_streams(bench):
    first = await bench.camera()
    await started(first)
    for stream in (1, 2, 3):
        first.on_frame(frame(stream))
    bench.next_facts = replace(FACTS, exposure_ns=20_000_000)
    first.on_failure(CameraError("unplugged"))
    second = await bench.camera()
    await started(second)
    second.on_frame(frame(1))
    streams = [stamp.stream for stamp in bench.stamps]
    assert streams == sorted(set(streams))
    assert len(streams) == 4


@pytest.mark.parametrize(
    ("delay_ns", "given_ns"), [(20_000_000, 12_000_000), (5_000_000, PERIOD_NS - 3_000_000)]
)
async def test_a_restart_keeps_its_aim_though_the_engine_took_8_ms(bench, delay_ns, given_ns):
    camera = await bench.camera()
    await started(camera)
    frame_ns = bench.now_ns
    bench.wanted = [RestartStream(delay_ns)]
    camera.on_frame(frame(1))
    assert await asyncio.wait_for(camera.commands.get(), 30) == RestartStream(given_ns)
    await asyncio.sleep(0)
    assert (bench.starts_ns[-1] - frame_ns - delay_ns) % PERIOD_NS == 0
