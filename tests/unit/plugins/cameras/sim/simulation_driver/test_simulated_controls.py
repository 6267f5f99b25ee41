import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.camera_facts import MICROSECONDS, Control
from capture_app.common.clock import HostClock
from capture_app.common.errors import BadInputError
from capture_app.plugins.cameras.sim.simulation_driver import open_camera
from tests.waiting import until

pytestmark = pytest.mark.virtual


async def test_a_set_exposure_is_that_of_the_frames_to_come() -> None:
    frames: list[CapturedFrame] = []
    camera = open_camera("phone-a", {"drops": "0"}, clock=HostClock(), name="a")
    await camera.start(frames.append, lambda _: None)
    try:
        await camera.set_control(Control.EXPOSURE, 8000.0)
        await camera.set_control(Control.GAIN, 2.5)
        # In whole rows of the sensor, no longer than asked for.
        rows_ns = 8_000_000 // 10_840 * 10_840
        await until(lambda: frames and frames[-1].exposure_ns == rows_ns and frames[-1].gain == 2.5)
        assert camera.facts.exposure_ns == rows_ns
        states = {state.control: state for state in await camera.controls()}
        assert states[Control.EXPOSURE].value == rows_ns / 1000
        assert states[Control.EXPOSURE].unit == MICROSECONDS
    finally:
        await camera.stop()


async def test_an_exposure_that_the_camera_chooses_changes_until_it_is_set() -> None:
    frames: list[CapturedFrame] = []
    camera = open_camera("perfect", {"auto": "exposure"}, clock=HostClock(), name="a")
    assert camera.facts.exposure_ns is None
    await camera.start(frames.append, lambda _: None)
    try:
        await until(lambda: len({frame.exposure_ns for frame in frames}) > 2)
        await camera.set_control(Control.EXPOSURE, 4000.0)
        assert camera.facts.exposure_ns is not None
        await camera.set_control(Control.EXPOSURE, None)
        assert camera.facts.exposure_ns is None
    finally:
        await camera.stop()


def test_only_the_exposure_can_be_automatic() -> None:
    with pytest.raises(BadInputError, match="auto=focus"):
        open_camera("pi", {"auto": "focus"}, clock=HostClock(), name="a")
