"""A machine-vision camera's stream, on a device in memory: stamps, numbers, durations, failures."""

import asyncio
import itertools
import threading
from collections.abc import AsyncIterator, Callable

import pytest
from msgspec.structs import replace

from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import open_camera
from capture_app.common.camera_facts import Control, PhaseControl, StampSource, TimestampSource
from capture_app.common.clock import HostClock
from capture_app.common.errors import BadInputError, CameraError
from capture_app.plugins.cameras.aravis.aravis_driver import AravisCamera, frames_between
from capture_app.sync.wire.camera_commands import RestartStream, SetFrameDuration
from tests.unit.plugins.cameras.aravis.fake_device import PIXELS, SETUP, FakeDevice
from tests.waiting import until


class DelayedDevice(FakeDevice):
    """Answers nothing before `answers` is set."""

    def __init__(self) -> None:
        super().__init__()
        self.facts = replace(SETUP, period_ns=100_000_000)
        self.answers = threading.Event()

    def set_period(self, period_ns: int) -> None:
        self.answers.wait(20.0)
        super().set_period(period_ns)


class Streaming:
    """A camera on a device, and what it has delivered."""

    def __init__(self, device: FakeDevice) -> None:
        self.device = device
        self.camera = AravisCamera(lambda: device, silence_ns=0)
        self.frames: list[CapturedFrame] = []
        self.failures: list[Exception] = []

    async def start(self, first: int = 1) -> None:
        for number in (first, first + 1):
            self.device.put(number)
        await self.camera.start(self.frames.append, self.failures.append)

    async def frames_until(self, holds: Callable[[], object]) -> None:
        """Let frames come until something holds."""
        for number in itertools.count(10):
            if holds():
                return
            self.device.put(number)
            await asyncio.sleep(0.02)


@pytest.fixture
async def begin() -> AsyncIterator[Callable[[FakeDevice], Streaming]]:
    begun: list[Streaming] = []

    def make(device: FakeDevice) -> Streaming:
        begun.append(Streaming(device))
        return begun[-1]

    yield make
    for one in begun:
        await one.camera.stop()
        assert one.device.closed


Begin = Callable[[FakeDevice], Streaming]


async def test_stamps_of_a_counter_that_is_read_are_the_hosts(begin: Begin) -> None:
    streaming = begin(FakeDevice(counter_offset_ns=77_000_000_000_000))
    await streaming.start()
    facts = streaming.camera.facts
    assert (facts.kind, facts.model, facts.phase_control) == (
        "aravis",
        "Maker Model",
        PhaseControl.FRAME_DURATION,
    )
    assert (facts.width, facts.height, facts.period_ns) == (SETUP.width, SETUP.height, SETUP.period_ns)
    assert facts.timestamp_source is TimestampSource.START_OF_EXPOSURE
    assert facts.stamp is not None
    assert facts.stamp.source is StampSource.PROFILE
    assert facts.stamp.uncertainty_ns == 3_000_000, "nobody knows which end of the exposure it stamps"
    begun_ns = streaming.device.put(7)
    await until(lambda: streaming.frames)
    frame = streaming.frames[0]
    assert abs(frame.timestamp_ns - begun_ns) < 100_000
    assert (frame.sequence, frame.exposure_ns) == (0, 3_000_000)
    assert 0 < frame.clock_uncertainty_ns < 1_000_000
    clock = streaming.camera.device_clock
    assert clock is not None
    assert clock.uncertainty_ns <= clock.hard_bound_ns
    assert frame.picture.held_bytes == len(PIXELS)
    streaming.device.put(8, whole=False)
    streaming.device.put(9, counter_ns=5)
    streaming.device.put(10)
    await until(lambda: len(streaming.frames) == 2)
    assert streaming.frames[1].sequence == 3, "damaged, and with a stamp of another time: dropped"


async def test_a_counter_that_cannot_be_read_promises_little(begin: Begin) -> None:
    streaming = begin(FakeDevice(counter_offset_ns=None))
    await streaming.start()
    assert streaming.camera.facts.timestamp_source is TimestampSource.UNKNOWN
    assert streaming.camera.facts.stamp_accuracy.source is StampSource.ASSUMED
    assert streaming.camera.device_clock is None
    begun_ns = streaming.device.put(3)
    await until(lambda: streaming.frames)
    assert abs(streaming.frames[0].timestamp_ns - (begun_ns + 8_000_000)) < 1_000_000, "its arrival"


async def test_one_frame_is_changed_by_two_words(begin: Begin) -> None:
    streaming = begin(FakeDevice())
    await streaming.start()
    await streaming.camera.apply(SetFrameDuration(1_100_000_000))
    await streaming.camera.apply(SetFrameDuration(900_000_000))
    assert streaming.device.periods_ns == [], "only when a frame has come"
    await streaming.frames_until(lambda: len(streaming.device.periods_ns) == 3)
    assert streaming.device.periods_ns == [1_100_000_000, 900_000_000, SETUP.period_ns]
    await streaming.camera.apply(SetFrameDuration(1_050_000_000))
    await streaming.frames_until(lambda: len(streaming.device.periods_ns) == 4)
    # Whether or not the next frame comes: its time does.
    await until(lambda: streaming.device.periods_ns[3:] == [1_050_000_000, SETUP.period_ns])
    with pytest.raises(CameraError, match="duration of its frames"):
        await streaming.camera.apply(RestartStream(0))


async def test_durations_that_wait_for_a_lost_answer_are_out_of_date(begin: Begin) -> None:
    """Sent in order, each would come later than the one before, and a frame's phase long after its time."""
    device = DelayedDevice()
    streaming = begin(device)
    await streaming.start()
    for number in range(5):
        await streaming.camera.apply(SetFrameDuration(110_000_000 + number))
    for number in range(10, 40):
        device.put(number)
        await asyncio.sleep(0.06)
    device.answers.set()
    await until(lambda: device.periods_ns[-1:] == [device.facts.period_ns])
    # The newest one at the first frame; on a busy machine that comes before they are all there.
    assert device.periods_ns[0] in range(110_000_000, 110_000_005)
    assert len(device.periods_ns) <= 3


async def test_an_exposure_that_is_set_holds_for_frames_and_facts(begin: Begin) -> None:
    streaming = begin(FakeDevice())
    with pytest.raises(CameraError, match="not connected"):
        await streaming.camera.controls()
    await streaming.start()
    await streaming.camera.set_control(Control.EXPOSURE, 250.0)
    (state,) = await streaming.camera.controls()
    assert state.value == 250.0
    facts = streaming.camera.facts
    assert facts.exposure_ns == 250_000
    assert facts.stamp is not None
    assert (facts.stamp.uncertainty_ns, facts.stamp.exposure_ns) == (250_000, 250_000)
    streaming.device.put(20)
    await until(lambda: streaming.frames)
    assert streaming.frames[0].exposure_ns == 250_000


async def test_what_goes_wrong_is_told(begin: Begin) -> None:
    lost, silent, deaf = (begin(FakeDevice()) for _ in range(3))
    for streaming in (lost, silent, deaf):
        await streaming.start()
    lost.device.lose()
    await until(lambda: lost.failures)
    assert "not controlled any more" in str(lost.failures[0])
    deaf.device.refuses = True
    await deaf.camera.apply(SetFrameDuration(1_100_000_000))
    await deaf.frames_until(lambda: deaf.failures)
    assert "does not answer" in str(deaf.failures[0])
    await until(lambda: silent.failures)
    assert "sends no pictures any more" in str(silent.failures[0])


async def test_it_is_known_when_it_has_started(begin: Begin) -> None:
    streaming = begin(FakeDevice())
    with pytest.raises(CameraError, match="before it starts"):
        _ = streaming.camera.facts
    with pytest.raises(CameraError, match="does not stream"):
        await streaming.camera.apply(SetFrameDuration(21_000_000))
    await streaming.start()
    with pytest.raises(CameraError, match="started already"):
        await streaming.camera.start(streaming.frames.append, streaming.failures.append)


def test_numbers_of_16_bits_go_on_without_0() -> None:
    steps = [frames_between(*pair) for pair in itertools.pairwise((65_533, 65_535, 1, 4, 3))]
    assert steps == [2, 1, 3, -1]
    wide = [frames_between(*pair) for pair in itertools.pairwise((0, 1, 70_000, 69_000))]
    assert wide == [1, 69_999, -1_000]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("rate=3", "no option 'rate'.*width, height"),
        ("fps=0", "fps=0 of a machine-vision camera"),
        ("width=x", "width=x"),
        ("exposure_us=nan", "from 0.1 to"),
    ],
)
def test_options_that_cannot_be_read_are_named(options: str, says: str) -> None:
    with pytest.raises(BadInputError, match=says):
        open_camera(f"aravis:10.0.0.2,{options}", clock=HostClock(), name="gige")
