"""Runs in the camera VM: webcams by OpenCV and the kernel's uvcvideo driver, one of them pulled out.

python webcam_in_guest.py OUT.json
"""

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

import cv2
import msgspec
import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import open_camera
from capture_app.common.clock import HostClock
from capture_app.common.errors import CameraError
from capture_app.common.host_clock import host_from_monotonic
from capture_app.plugins.cameras.webcam.device_names import camera_names

FRAMES = 60


class Stamping:
    """OpenCV's capture, which notes the driver's own stamp of each frame: the arrival of its first bytes."""

    def __init__(self, *arguments: int) -> None:
        self._capture, self.stamps_ns = CAPTURE(*arguments), list[int]()
        opened.append(self)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._capture, name)

    def read(self) -> Any:
        done = self._capture.read()
        self.stamps_ns.append(round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6))
        return done


CAPTURE, opened = cv2.VideoCapture, list[Stamping]()


def pull_out() -> None:
    """Unplug the second camera."""
    Path("/sys/devices/platform/vhci_hcd.0/detach").write_text("1")


async def delivered(spec: str, folder: Path) -> dict[str, Any]:
    """Run a camera; return its facts, and each frame's delay after the driver's stamp with its bar."""
    camera = open_camera(spec, clock=HostClock(), name="a")
    frames: list[CapturedFrame] = []
    failures: list[Exception] = []
    try:
        await camera.start(frames.append, failures.append)
        while len(frames) < FRAMES:  # noqa: ASYNC110 - frames tell nobody
            await asyncio.sleep(0.05)
        if spec.endswith("LabCam 1"):
            pull_out()
            while not failures:  # noqa: ASYNC110 - the same
                await asyncio.sleep(0.05)
    except CameraError as error:
        return {"error": str(error)}
    finally:
        await camera.stop()
    (folder / f"{camera.facts.pixel_format}.jpg").write_bytes(frames[0].picture.encode())
    stamps_ns = [host_from_monotonic(stamp_ns) for stamp_ns in opened[-1].stamps_ns]
    return {
        "facts": camera.facts,
        "late_ns": [
            frame.timestamp_ns - max(at for at in stamps_ns if at < frame.timestamp_ns) for frame in frames
        ],
        "bars_ns": [frame.clock_uncertainty_ns for frame in frames],
        "numbers": [frame.sequence for frame in frames],
        "failures": [str(failure) for failure in failures],
    }


async def main(folder: Path) -> dict[str, Any]:
    pytest.MonkeyPatch().setattr(cv2, "VideoCapture", Stamping)
    specs = ("webcam:0", "webcam:LabCam 0,format=YUYV", "webcam:0,width=640", "webcam:7", "webcam:LabCam 1")
    found: dict[str, Any] = {"names": camera_names()}
    for spec in specs:
        found[spec] = await delivered(spec, folder)
    return found


result = asyncio.run(main(Path(sys.argv[1]).parent))
Path(sys.argv[1]).write_text(json.dumps(msgspec.to_builtins(result, str_keys=True)))
