import asyncio
from itertools import pairwise

import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import open_camera
from capture_app.common.camera_facts import PhaseControl, TimestampSource
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import BadInputError, CameraError
from capture_app.sync.wire.camera_commands import InjectFrame, RestartStream
from tests.unit.plugins.cameras.sim.simulation_driver.stepped import (
    HOUR_NS,
    PERIOD_NS,
    Recorder,
    SteppedLoop,
    frames_of,
    in_stepped_time,
    sim,
    starts,
    true_now_ns,
)

pytestmark = pytest.mark.virtual


@in_stepped_time
async def test_frames_arrive_in_order_after_their_readout_in_the_nodes_clock() -> None:
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


@in_stepped_time
async def test_a_dropped_frame_is_a_gap_in_the_sequence() -> None:
    frames = await frames_of(sim("sim:perfect,drops=0.2,seed=3"), 20.0)
    gaps = {b.sequence - a.sequence for a, b in pairwise(frames)}
    assert 1 in gaps
    assert 2 in gaps
    assert 0.7 < len(frames) / (frames[-1].sequence + 1) < 0.9
    for a, b in pairwise(frames):
        assert b.timestamp_ns - a.timestamp_ns == (b.sequence - a.sequence) * PERIOD_NS


@in_stepped_time
async def test_all_frames_dropped_is_silence_not_a_busy_loop() -> None:
    assert await frames_of(sim("sim:perfect,drops=1"), 1.0) == []


@in_stepped_time
async def test_injection_moves_the_phase() -> None:
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


@in_stepped_time
async def test_restart_starts_a_new_stream_after_the_delay() -> None:
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


@in_stepped_time
async def test_stop_ends_frames_and_a_restart_under_way_and_twice_is_harmless() -> None:
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


@in_stepped_time
async def test_a_camera_may_be_stopped_from_its_own_callback() -> None:
    camera = sim("sim:perfect")
    frames: list[CapturedFrame] = []
    stops: list[asyncio.Task[None]] = []

    def on_frame(frame: CapturedFrame) -> None:
        frames.append(frame)
        stops.append(asyncio.create_task(camera.stop()))

    await camera.start(on_frame, lambda error: None)
    await asyncio.sleep(1.0)
    assert len(frames) == 1


@in_stepped_time
async def test_a_webcam_refuses_to_inject() -> None:
    camera = sim("sim:webcam")
    assert camera.facts.phase_control is PhaseControl.RESET
    await Recorder().record(camera, 0.1)
    with pytest.raises(CameraError, match="cannot inject"):
        await camera.apply(InjectFrame(40_000_000))
    await camera.stop()


@in_stepped_time
async def test_going_away_is_told_once() -> None:
    camera = sim("sim:perfect,fail_after_s=0.5")
    recorder = Recorder()
    frames = await recorder.record(camera, 3.0)
    assert [type(error) for error in recorder.failures] == [CameraError]
    assert len(frames) == 15


@in_stepped_time
async def test_a_stalled_node_loses_frames_like_a_full_driver() -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, SteppedLoop)
    camera = sim("sim:perfect")
    recorder = Recorder()
    await recorder.record(camera, 1.0)
    last = recorder.frames[-1].sequence
    loop.selector.now_s += 2.0
    await asyncio.sleep(0.5)
    await camera.stop()
    sequences = [f.sequence for f in recorder.frames[last + 1 :]]
    assert sequences[0] - last == pytest.approx(45, abs=2)
    assert sequences == list(range(sequences[0], sequences[-1] + 1))


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
        ("sim:pi,exposure_ms=33.4", "does not fit"),
        ("sim:pi,view=left", "no view"),
    ],
)
def test_bad_options_say_what_would_be_good(spec: str, needle: str) -> None:
    with pytest.raises(BadInputError) as error:
        sim(spec)
    assert needle in str(error.value)


async def test_in_real_time_timestamps_are_in_the_nodes_clock() -> None:
    clock = SimulatedClock(5 * HOUR_NS, -40.0)
    camera = open_camera("sim:perfect", clock=clock, name="a")
    arrived: asyncio.Future[tuple[CapturedFrame, int]] = asyncio.get_running_loop().create_future()
    before_ns = clock.now_ns()

    def note(frame: CapturedFrame) -> None:
        if not arrived.done():
            arrived.set_result((frame, clock.now_ns()))

    await camera.start(note, print)
    frame, now_ns = await arrived
    await camera.stop()
    assert before_ns <= frame.timestamp_ns < now_ns
