"""Exposure, gain, white balance and focus on the kernel's own uvcvideo driver, in a virtual machine.

`make test KIND=v4l2` runs it. `usb_cameras_with_controls.py` is what the driver talks to over the USB bus,
and `webcam_controls_in_guest.py` what talks to the driver.
"""

import json
import sys
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from tests.nightly.drivers.camera_vm import boot, find_camera_vm
from tests.project import ROOT

pytestmark = pytest.mark.timeout(1800)

HERE = Path(__file__).parent
GUEST = f"""
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH={ROOT}
cd {ROOT}
python3 {HERE / "usb_cameras_with_controls.py"} {{camera_vm}} /out/usb.txt >/out/usb_cameras.log 2>&1 &
until [ -e /dev/video2 ]; do sleep .1; done
sleep 1
{sys.executable} {HERE / "slewed_clock_in_guest.py"} /out/slewed.json >/out/slewed.log 2>&1
{sys.executable} {HERE / "webcam_controls_in_guest.py"} /out/found.json >/out/guest.log 2>&1
"""

TERMINAL, UNIT = 1, 2
AE_MODE, EXPOSURE, GAIN, WHITE_BALANCE, WHITE_BALANCE_AUTO = 2, 4, 4, 10, 11
MANUAL, APERTURE_PRIORITY = 1, 8


@pytest.fixture(scope="module")
def out(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One boot."""
    camera_vm, folder = find_camera_vm(shared), tmp_path_factory.mktemp("controls")
    boot(camera_vm, GUEST.format(camera_vm=camera_vm), folder, last="found.json")
    return folder


def found(out: Path, part: str) -> Any:
    return json.loads((out / "found.json").read_text())[part]


def state(out: Path, part: str, control: str) -> dict[str, Any]:
    """A control as it stood in that part of the run."""
    return next(one for one in found(out, part)["controls"] if one["control"] == control)


def set_on(out: Path, side: str) -> list[tuple[int, int, int]]:
    """What the driver has set on a camera: unit, selector and value, in their order."""
    lines = (line.split() for line in (out / "usb.txt").read_text().splitlines())
    return [
        (int(unit), int(selector), int(value)) for name, _, unit, selector, value in lines if name == side
    ]


def test_a_webcams_controls_are_read_in_their_units(out: Path) -> None:
    units = {one["control"]: one["unit"] for one in found(out, "before")["controls"]}
    assert units == {
        "exposure": "µs",
        "gain": "steps of LabCam 0",
        "white-balance": "K",
        "focus": "steps of LabCam 0",
    }
    assert state(out, "before", "exposure")["automatic"]
    assert state(out, "before", "exposure")["maximum"] == 1_000_000.0


def test_what_a_webcam_chooses_is_locked_during_a_burst(out: Path) -> None:
    locked = state(out, "locked", "exposure")
    assert "automatic" not in locked
    assert found(out, "exposures") == [round(locked["value"] * 1000)] * 20
    assert state(out, "after", "exposure")["automatic"]
    first = set_on(out, "left")[:3]
    assert first == [
        (TERMINAL, AE_MODE, MANUAL),
        (TERMINAL, EXPOSURE, round(locked["value"] / 100)),
        (TERMINAL, AE_MODE, APERTURE_PRIORITY),
    ]


def test_what_one_webcam_has_chosen_is_set_on_another(out: Path) -> None:
    held = state(out, "held", "exposure")["value"]
    assert state(out, "set", "exposure")["value"] == held
    assert found(out, "exposures set") == [round(held * 1000)] * 20
    assert set_on(out, "right")[:2] == [
        (TERMINAL, AE_MODE, MANUAL),
        (TERMINAL, EXPOSURE, round(held / 100)),
    ]
    assert (UNIT, WHITE_BALANCE_AUTO, 0) in set_on(out, "right")
    assert (UNIT, WHITE_BALANCE, 4600) in set_on(out, "right")


def test_what_a_webcam_cannot_do_is_said(out: Path) -> None:
    assert found(out, "set")["problems"] == {"focus": "its focus cannot be controlled"}
    assert found(out, "too long")["problems"] == {"exposure": "9000 µs is out of its range, 100 to 3000"}
    assert state(out, "too long", "exposure")["value"] == 3000.0


def test_a_webcam_goes_back_to_choosing_itself(out: Path) -> None:
    assert state(out, "auto", "exposure")["automatic"]
    assert set_on(out, "right")[-1] == (TERMINAL, AE_MODE, APERTURE_PRIORITY)


def test_times_are_brought_out_of_a_clock_that_the_kernel_slews(out: Path) -> None:
    """A quarter of what a twelfth amounts to between two readings, 5 ms apart, and the readings' own time."""
    slewed = json.loads((out / "slewed.json").read_text())
    assert slewed["ahead_ns"] > 100_000_000, "the kernel did slew it"
    for part in ("before", "slewed", "after"):
        assert median(map(abs, slewed[part])) < 10_000
        assert max(map(abs, slewed[part])) < 1_000_000
