"""Webcams by OpenCV on the kernel's own uvcvideo driver, in a virtual machine with two USB cameras.

`make test KIND=v4l2` runs it. DirectShow and AVFoundation run the same code of ours behind OpenCV.
"""

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import pytest

from tests.nightly.drivers.camera_vm import boot, find_camera_vm
from tests.project import ROOT

pytestmark = pytest.mark.timeout(1800)

GUEST = f"""
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH={ROOT}
cd {ROOT}
python3 {{camera_vm}}/usb_cameras.py 2 >/out/usb_cameras.log 2>&1 &
until [ -e /dev/video2 ]; do sleep .1; done
sleep 1
{sys.executable} {Path(__file__).with_name("webcam_in_guest.py")} /out/found.json >/out/guest.log 2>&1
"""


@pytest.fixture(scope="module")
def camera_vm(shared: Path) -> Path:
    return find_camera_vm(shared)


@pytest.fixture(scope="module")
def out(camera_vm: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One boot."""
    folder = tmp_path_factory.mktemp("webcam")
    boot(camera_vm, GUEST.format(camera_vm=camera_vm), folder, last="found.json")
    return folder


@pytest.fixture(scope="module")
def found(out: Path) -> dict[str, Any]:
    return dict(json.loads((out / "found.json").read_text()))


def test_cameras_have_the_names_that_the_kernel_gives_them(found: dict[str, Any]) -> None:
    assert found["names"] == {"0": "LabCam 0", "2": "LabCam 1"}
    assert found["webcam:0"]["facts"]["model"] == "LabCam 0"


def test_a_cameras_own_jpeg_is_kept_and_raw_pixels_are_encoded(
    found: dict[str, Any], out: Path, camera_vm: Path
) -> None:
    assert found["webcam:0"]["facts"]["pixel_format"] == "MJPG"
    assert (out / "MJPG.jpg").read_bytes() == (camera_vm / "frame.jpg").read_bytes()
    assert found["webcam:LabCam 0,format=YUYV"]["facts"]["pixel_format"] == "YUYV"
    assert cv2.imread(str(out / "YUYV.jpg")).shape == (240, 320, 3)


@pytest.mark.parametrize("spec", ["webcam:0", "webcam:LabCam 0,format=YUYV"])
def test_the_error_bar_before_calibration_contains_the_time_of_the_first_bytes(
    found: dict[str, Any], spec: str
) -> None:
    """The driver stamps a frame at its first bytes; before these cameras is no sensor: that is its time."""
    camera = found[spec]
    stamp = camera["facts"]["stamp"]
    assert (camera["facts"]["period_ns"], stamp["source"]) == (33_333_333, "assumed")
    assert stamp["uncertainty_ns"] < 90_000_000
    for late_ns, bar_ns in zip(camera["late_ns"], camera["bars_ns"], strict=True):
        assert abs(late_ns - stamp["bias_ns"]) <= stamp["uncertainty_ns"] + bar_ns
    assert camera["numbers"] == list(range(1, len(camera["numbers"]) + 1))


def test_a_mode_and_a_camera_that_are_not_there_are_said(found: dict[str, Any]) -> None:
    assert "it delivers MJPG 320x240 at 30 fps" in found["webcam:0,width=640"]["error"]
    assert "webcam:7 (webcam 7) does not open" in found["webcam:7"]["error"]


def test_a_camera_that_is_pulled_out_fails(found: dict[str, Any]) -> None:
    assert found["webcam:LabCam 1"]["failures"] == [
        "webcam:2 (LabCam 1) sends no frames (unplug it and plug it in again)"
    ]
