import errno

import pytest

from capture_app.common.camera_facts import KELVIN, MICROSECONDS, Control, ControlState, steps_of
from capture_app.common.errors import CameraError
from capture_app.plugins.cameras.v4l2 import kernel as v4l2
from capture_app.plugins.cameras.v4l2.v4l2_driver import V4L2Camera, read_controls, set_control
from tests.unit.plugins.cameras.v4l2.fake_device import MJPG, PERIOD_NS, FakeDevice

WEBCAM = {
    "EXPOSURE_AUTO": v4l2.EXPOSURE_APERTURE_PRIORITY,
    "EXPOSURE_ABSOLUTE": 157,
    "GAIN": 4,
    "AUTO_WHITE_BALANCE": 1,
    "WHITE_BALANCE_K": 4600,
}


class Webcam(FakeDevice):
    """A device that refuses to be called plainly automatic, or anything else."""

    def __init__(self, refuses: tuple[int, ...] = ()) -> None:
        super().__init__()
        self.controls, self.refuses = dict(WEBCAM), refuses

    def set_control(self, control: str, value: int) -> None:
        if control == "EXPOSURE_AUTO" and value in self.refuses:
            raise OSError(errno.EINVAL, "no such choice")
        super().set_control(control, value)


def by_name(states: tuple[ControlState, ...]) -> dict[Control, ControlState]:
    return {state.control: state for state in states}


def test_a_webcams_controls_are_told_in_their_units() -> None:
    states = by_name(read_controls(Webcam(), "C920"))
    assert set(states) == {Control.EXPOSURE, Control.GAIN, Control.WHITE_BALANCE}
    exposure = states[Control.EXPOSURE]
    assert (exposure.value, exposure.unit, exposure.automatic) == (15_700.0, MICROSECONDS, True)
    assert (exposure.minimum, exposure.maximum) == (100.0, 500_000.0)
    gain = states[Control.GAIN]
    assert (gain.value, gain.unit) == (4.0, steps_of("C920"))
    assert not gain.automatic
    assert not gain.can_be_automatic
    white = states[Control.WHITE_BALANCE]
    assert (white.value, white.unit, white.automatic) == (4600.0, KELVIN, True)


def test_setting_takes_the_camera_out_of_automatic() -> None:
    device = Webcam()
    set_control(device, Control.EXPOSURE, 4040.0)
    set_control(device, Control.WHITE_BALANCE, 5000.0)
    assert device.controls["EXPOSURE_AUTO"] == v4l2.EXPOSURE_MANUAL
    assert device.controls["EXPOSURE_ABSOLUTE"] == 40
    assert device.controls["AUTO_WHITE_BALANCE"] == 0
    assert device.controls["WHITE_BALANCE_K"] == 5000


@pytest.mark.parametrize(
    ("refuses", "then"),
    [
        ((), v4l2.EXPOSURE_APERTURE_PRIORITY),
        ((v4l2.EXPOSURE_APERTURE_PRIORITY,), v4l2.EXPOSURE_AUTO),
    ],
)
def test_automatic_is_what_the_driver_takes_for_it(refuses: tuple[int, ...], then: int) -> None:
    device = Webcam(refuses)
    set_control(device, Control.EXPOSURE, 4000.0)
    set_control(device, Control.EXPOSURE, None)
    assert device.controls["EXPOSURE_AUTO"] == then


async def test_a_camera_tells_its_new_exposure() -> None:
    device = Webcam()
    camera = V4L2Camera(device, MJPG, PERIOD_NS)
    assert camera.facts.exposure_ns is None
    await camera.set_control(Control.EXPOSURE, 4000.0)
    assert camera.facts.exposure_ns == 4_000_000
    assert by_name(await camera.controls())[Control.EXPOSURE].value == 4000.0
    await camera.set_control(Control.EXPOSURE, None)
    assert camera.facts.exposure_ns is None
    await camera.stop()


async def test_a_device_that_is_gone_is_told_in_words() -> None:
    camera = V4L2Camera(Webcam(refuses=(v4l2.EXPOSURE_MANUAL,)), MJPG, PERIOD_NS)
    with pytest.raises(CameraError, match="/dev/video0"):
        await camera.set_control(Control.EXPOSURE, 4000.0)
    await camera.stop()


async def test_a_camera_that_was_stopped_has_none_and_takes_none() -> None:
    camera = V4L2Camera(Webcam(), MJPG, PERIOD_NS)
    await camera.stop()
    assert await camera.controls() == ()
    with pytest.raises(CameraError, match="was stopped"):
        await camera.set_control(Control.GAIN, 1.0)
