import asyncio
import io
from collections.abc import Callable, Coroutine
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from capture_app.camera_facts import PhaseControl, TimestampSource
from capture_app.cameras.base import Camera, CapturedFrame
from capture_app.cameras.catalog import open_camera
from capture_app.clock import SimulatedClock
from capture_app.errors import BadInputError, CameraError, NotAvailableError, SimulshotError
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.simulation.rendering import pictures
from capture_app.sync.wire.camera_commands import InjectFrame, RestartStream

PERIOD_NS = 33_333_000
HOUR_NS = 3_600_000_000_000


class SteppedLoop(asyncio.SelectorEventLoop):
    """An event loop whose time jumps to the next timer, so that seconds of streaming take milliseconds."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 1000.0
        selector: Any = self._selector
        poll = selector.select

        def select(timeout: float | None) -> Any:
            assert timeout is not None, "the test waits for something that never comes"
            self.now_s += timeout
            return poll(0)

        selector.select = select

    def time(self) -> float:
        return self.now_s


class LoopClock:
    """A node clock two hours ahead of the loop's time, which is true time here."""

    def local_from_true(self, true_ns: int) -> int:
        return true_ns + 2 * HOUR_NS

    def true_from_local(self, local_ns: int) -> int:
        return local_ns - 2 * HOUR_NS

    def now_ns(self) -> int:
        return self.local_from_true(true_now_ns())


def true_now_ns() -> int:
    return round(asyncio.get_running_loop().time() * 1e9)


def run(scenario: Callable[[], Coroutine[Any, Any, None]]) -> None:
    loop = SteppedLoop()
    try:
        loop.run_until_complete(scenario())
    finally:
        loop.close()


def sim(spec: str, name: str = "cam00") -> Camera:
    return open_camera(spec, clock=LoopClock(), name=name)


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
    assert all(frame.truth is not None for frame in frames)
    return [frame.truth.true_ns for frame in frames if frame.truth is not None]


def test_frames_arrive_in_order_after_their_readout_in_the_nodes_clock() -> None:
    async def scenario() -> None:
        recorder = Recorder()
        camera = sim("sim:perfect")
        begun_true_ns = true_now_ns()
        frames = await recorder.record(camera, 3.0)
        await camera.stop()
        assert [f.sequence for f in frames] == list(range(len(frames)))
        assert len(frames) >= 89
        assert starts(frames) == [begun_true_ns + k * PERIOD_NS for k in range(len(frames))]
        assert [f.timestamp_ns for f in frames] == [start + 2 * HOUR_NS for start in starts(frames)]
        readout_ns = 480 * 11_111
        for frame, start, arrival in zip(frames, starts(frames), recorder.arrivals_true_ns, strict=True):
            assert frame.exposure_ns is not None
            late_ns = arrival - (start + frame.exposure_ns + readout_ns)
            assert 1_999_000 <= late_ns <= 4_001_000

    run(scenario)


def test_a_dropped_frame_is_a_gap_in_the_sequence() -> None:
    async def scenario() -> None:
        camera = sim("sim:perfect,drops=0.2,seed=3")
        frames = await Recorder().record(camera, 20.0)
        await camera.stop()
        gaps = {b.sequence - a.sequence for a, b in pairwise(frames)}
        assert 1 in gaps
        assert 2 in gaps
        assert 0.7 < len(frames) / (frames[-1].sequence + 1) < 0.9
        for a, b in pairwise(frames):
            assert b.timestamp_ns - a.timestamp_ns == (b.sequence - a.sequence) * PERIOD_NS

    run(scenario)


def test_all_frames_dropped_is_silence_not_a_busy_loop() -> None:
    async def scenario() -> None:
        camera = sim("sim:perfect,drops=1")
        assert await Recorder().record(camera, 1.0) == []
        await camera.stop()

    run(scenario)


def test_injection_moves_the_phase() -> None:
    async def scenario() -> None:
        camera = sim("sim:phone-a,ppm=0,drops=0,outliers=0,noise_us=0")
        recorder = Recorder()
        before = (await recorder.record(camera, 1.0))[-1]
        await camera.apply(InjectFrame(PERIOD_NS + 2_000_000))
        await asyncio.sleep(1.0)
        after = recorder.frames[-1]
        await camera.stop()
        whole = (after.sequence - before.sequence) * PERIOD_NS
        rows = (PERIOD_NS + 2_000_000) // 10_840 - (3075 - 19)
        assert after.timestamp_ns - before.timestamp_ns == whole + 2 * rows * 10_840
        assert sum(f.exposure_ns is not None and f.exposure_ns > 30_000_000 for f in recorder.frames) == 1

    run(scenario)


def test_restart_starts_a_new_stream_after_the_delay() -> None:
    async def scenario() -> None:
        camera = sim("sim:webcam,drops=0,start_ms=260")
        recorder = Recorder()
        await recorder.record(camera, 1.0)
        asked_true_ns = true_now_ns()
        before = len(recorder.frames)
        await camera.apply(RestartStream(17_000_000))
        assert true_now_ns() == pytest.approx(asked_true_ns + 17_000_000, abs=1000)
        await asyncio.sleep(1.0)
        await camera.stop()
        first = recorder.frames[before]
        assert (first.stream, first.sequence) == (1, 0)
        assert starts([first]) == [asked_true_ns + 17_000_000 + 260_000_000]

    run(scenario)


def test_stop_ends_frames_and_a_restart_under_way_and_twice_is_harmless() -> None:
    async def scenario() -> None:
        camera = sim("sim:perfect")
        recorder = Recorder()
        await recorder.record(camera, 0.5)
        restart = asyncio.create_task(camera.apply(RestartStream(10**9)))
        await asyncio.sleep(0.1)
        seen = len(recorder.frames)
        await camera.stop()
        await camera.stop()
        await restart
        await asyncio.sleep(2.0)
        assert len(recorder.frames) == seen
        with pytest.raises(CameraError, match="does not stream"):
            await camera.apply(InjectFrame(40_000_000))
        await camera.start(recorder.on_frame, recorder.failures.append)
        with pytest.raises(CameraError, match="already"):
            await camera.start(recorder.on_frame, recorder.failures.append)
        await asyncio.sleep(0.5)
        await camera.stop()
        assert recorder.frames[-1].stream == 1

    run(scenario)


def test_a_camera_may_be_stopped_from_its_own_callback() -> None:
    async def scenario() -> None:
        camera = sim("sim:perfect")
        frames: list[CapturedFrame] = []
        stops: list[asyncio.Task[None]] = []

        def on_frame(frame: CapturedFrame) -> None:
            frames.append(frame)
            stops.append(asyncio.create_task(camera.stop()))

        await camera.start(on_frame, lambda error: None)
        await asyncio.sleep(1.0)
        assert len(frames) == 1

    run(scenario)


def test_a_webcam_refuses_to_inject() -> None:
    async def scenario() -> None:
        camera = sim("sim:webcam")
        assert camera.facts.phase_control is PhaseControl.RESET
        await Recorder().record(camera, 0.1)
        with pytest.raises(CameraError, match="cannot inject"):
            await camera.apply(InjectFrame(40_000_000))
        await camera.stop()

    run(scenario)


def test_going_away_is_told_once() -> None:
    async def scenario() -> None:
        camera = sim("sim:perfect,fail_after_s=0.5")
        recorder = Recorder()
        frames = await recorder.record(camera, 3.0)
        assert [type(error) for error in recorder.failures] == [CameraError]
        assert len(frames) == 15

    run(scenario)


def test_a_stalled_node_loses_frames_like_a_full_driver() -> None:
    async def scenario() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, SteppedLoop)
        camera = sim("sim:perfect")
        recorder = Recorder()
        await recorder.record(camera, 1.0)
        last = recorder.frames[-1].sequence
        loop.now_s += 2.0
        await asyncio.sleep(0.5)
        await camera.stop()
        sequences = [f.sequence for f in recorder.frames[last + 1 :]]
        assert sequences[0] - last == pytest.approx(45, abs=2)
        assert sequences == list(range(sequences[0], sequences[-1] + 1))

    run(scenario)


def test_pictures_are_reproducible_jpegs_that_differ_by_camera() -> None:
    async def shoot(name: str) -> CapturedFrame:
        camera = sim("sim:perfect", name)
        frame = (await Recorder().record(camera, 0.5))[7]
        await camera.stop()
        return frame

    frames: list[CapturedFrame] = []

    async def scenario() -> None:
        frames.append(await shoot("left"))

    async def other() -> None:
        frames.append(await shoot("right"))

    for each in (scenario, scenario, other):
        run(each)
    first, again, right = (frame.payload.encode() for frame in frames)
    assert first == again
    assert first != right
    image = cv2.imdecode(np.frombuffer(first, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (480, 640, 3)
    assert np.asarray(image).std() > 40


def test_truth_is_an_npz_of_depth_objects_and_movers() -> None:
    async def scenario() -> None:
        camera = sim("sim:perfect")
        frame = (await Recorder().record(camera, 0.2))[0]
        await camera.stop()
        assert frame.truth is not None
        with np.load(io.BytesIO(frame.truth.encode())) as truth:
            kinds = {key: (truth[key].dtype.name, truth[key].shape) for key in truth}
        assert kinds == {
            "depth_m": ("float32", (480, 640)),
            "objects": ("uint8", (480, 640)),
            "movers": ("bool", (480, 640)),
        }

    run(scenario)


def test_info() -> None:
    facts = sim("sim:phone-b,exposure_ms=2").facts
    assert (facts.kind, facts.model, facts.width, facts.height) == ("sim", "Simulated phone B", 640, 480)
    assert facts.period_ns == PERIOD_NS
    assert facts.row_time_ns == 12_300
    assert facts.exposure_ns == 162 * 12_300
    assert facts.phase_control is PhaseControl.INJECTION
    assert facts.timestamp_source is TimestampSource.START_OF_EXPOSURE


@pytest.mark.parametrize(
    ("spec", "needle"),
    [
        ("sim:nikon", "phone-a, phone-b"),
        ("sim:pi,colour=red", "exposure_ms"),
        ("sim:pi,drops=2", "from 0 to 1"),
        ("sim:pi,ppm=nan", "number"),
        ("sim:pi,scale=2", "from 0.1 to 1"),
        ("sim:pi,seed=x", "whole number"),
        ("sim:pi,exposure_ms=33.4", "does not fit"),
        ("sim:pi,view=left", "no view"),
    ],
)
def test_bad_options_say_what_would_be_good(spec: str, needle: str) -> None:
    with pytest.raises(BadInputError) as error:
        sim(spec)
    assert needle in str(error.value)


def test_a_scene_without_open3d_is_refused_in_plain_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise OSError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr(pictures.importlib, "import_module", missing)
    with pytest.raises(NotAvailableError, match=r"libGL\.so\.1.*scene=bars") as error:
        sim("sim:pi,scene=plaza")
    assert isinstance(error.value, SimulshotError)
    sim("sim:pi,scene=bars")


class StripedScene:
    """Stands in for a rendered scene and remembers what it was asked to render."""

    views: ClassVar = {"left": None, "right": None}

    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []

    def render(self, *args: Any, seed: int) -> Any:
        self.asked.append((*args, seed))
        return np.full((90, 160, 3), 128, np.uint8)

    def ground_truth(self, *args: Any) -> Any:
        self.asked.append(args)
        return np.ones((90, 160), np.float32), np.ones((90, 160), np.uint8), np.ones((90, 160), np.bool_)

    def calibration(self) -> Calibration:
        identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        view = CameraCalibration(
            width=160, height=90, fx=1, fy=1, cx=0, cy=0, rotation=identity, translation=(0.0, 0.0, 0.0)
        )
        return Calibration(cameras=dict.fromkeys(self.views, view))


@pytest.fixture
def striped(monkeypatch: pytest.MonkeyPatch) -> StripedScene:
    scene = StripedScene()
    module = SimpleNamespace(load=lambda name, *, scale: scene)
    monkeypatch.setattr(pictures.importlib, "import_module", lambda name: module)
    return scene


def test_a_scene_is_rendered_at_the_frames_true_start_when_it_is_saved(striped: StripedScene) -> None:
    async def scenario() -> None:
        camera = sim("sim:pi,scene=striped,view=right,drops=0")
        assert (camera.facts.width, camera.facts.height) == (160, 90)
        recorder = Recorder()
        frame, later = (await recorder.record(camera, 1.0))[:2]
        await camera.stop()
        assert striped.asked == []
        assert frame.truth is not None
        frame.payload.encode()
        frame.truth.encode()
        frame.payload.encode()
        later.payload.encode()
        (view, start_ns, exposure_ns, row_time_ns, seed), truth, again, other = striped.asked
        assert (view, start_ns, exposure_ns, row_time_ns) == truth
        assert truth == ("right", frame.truth.true_ns, frame.exposure_ns, 11_111)
        assert again[-1] == seed != other[-1]
        # 90 rows are read out in 1 ms.
        assert frame.exposure_ns is not None
        late_ns = recorder.arrivals_true_ns[0] - start_ns - frame.exposure_ns
        assert 2_999_000 <= late_ns <= 5_001_000

    run(scenario)


def test_the_rendered_scene() -> None:
    pytest.importorskip("open3d", reason="scenes are rendered by Open3D")

    async def scenario() -> None:
        camera = sim("sim:phone-a,scene=studio,scale=0.25", "cam02")
        frame = (await Recorder().record(camera, 1.0))[0]
        await camera.stop()
        assert frame.truth is not None
        image = cv2.imdecode(np.frombuffer(frame.payload.encode(), np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert image.shape == (camera.facts.height, camera.facts.width, 3) == (120, 160, 3)
        assert np.asarray(image).std() > 20
        with np.load(io.BytesIO(frame.truth.encode())) as truth:
            assert truth["depth_m"].shape == (120, 160)
            assert 0.0 < truth["movers"].mean() < 0.5
            assert (truth["depth_m"][truth["movers"]] > 0.1).all()

    run(scenario)


def test_a_scene_that_does_not_exist() -> None:
    pytest.importorskip("open3d", reason="scenes are rendered by Open3D")
    with pytest.raises(BadInputError, match="studio"):
        sim("sim:pi,scene=moon")


def test_the_view_is_the_one_named_like_the_node(striped: StripedScene) -> None:
    sim("sim:pi,scene=striped", "left")
    with pytest.raises(BadInputError, match=r"no view 'cam00'.*left, right"):
        sim("sim:pi,scene=striped")


async def test_in_real_time_timestamps_are_in_the_nodes_clock() -> None:
    clock = SimulatedClock(5 * HOUR_NS, -40.0)
    camera = open_camera("sim:perfect", clock=clock, name="a")
    arrived: asyncio.Future[tuple[CapturedFrame, int]] = asyncio.get_running_loop().create_future()
    before_ns = clock.now_ns()
    await camera.start(lambda f: arrived.done() or arrived.set_result((f, clock.now_ns())), print)
    frame, now_ns = await arrived
    await camera.stop()
    assert before_ns <= frame.timestamp_ns < now_ns
