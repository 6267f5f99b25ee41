"""Runs in the camera VM, on the kernel's uvcvideo driver: keeps the controls of two cameras as nodes do.

python webcam_controls_in_guest.py OUT.json
"""

import asyncio
import json
import sys
from pathlib import Path
from typing import Any, cast

import msgspec

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.camera_facts import Control
from capture_app.common.clock import HostClock
from capture_app.node.camera.supervisor import CameraSupervisor, ControlKeeper
from capture_app.plugins.cameras.v4l2.v4l2_driver import open_camera

DEVICES = {"left": "/dev/video0", "right": "/dev/video2"}
FRAMES = 20


class Webcam:
    """One camera with its keeper, as a node has them."""

    def __init__(self, name: str) -> None:
        self.camera = open_camera(DEVICES[name], {}, clock=HostClock(), name=name)
        self.keeper = ControlKeeper(cast(CameraSupervisor, self))
        self.frames: list[CapturedFrame] = []

    def note_exposure(self) -> None:
        """Nobody looks."""

    async def exposures(self) -> list[int | None]:
        """The exposures of the next frames, in ns."""
        begin = len(self.frames)
        while len(self.frames) < begin + FRAMES:  # noqa: ASYNC110 - frames tell nobody
            await asyncio.sleep(0.05)
        return [frame.exposure_ns for frame in self.frames[begin : begin + FRAMES]]


async def main() -> dict[str, Any]:
    """Look, lock as for a burst, hold the left camera's controls, and set them on the right one."""
    left, right = Webcam("left"), Webcam("right")
    found: dict[str, Any] = {}
    tasks = []
    for one in (left, right):
        await one.camera.start(one.frames.append, lambda error: print(error, file=sys.stderr))
        tasks.append(asyncio.create_task(one.keeper.run()))
    await asyncio.sleep(7.0)
    found["before"] = await left.keeper.read()
    left.keeper.set_in_burst(True)
    await asyncio.sleep(1.0)
    found["locked"] = await left.keeper.read()
    found["exposures"] = await left.exposures()
    left.keeper.set_in_burst(False)
    await asyncio.sleep(1.0)
    found["after"] = await left.keeper.read()
    found["held"] = held = await left.keeper.apply(dict.fromkeys(Control, "hold"))
    wanted = {state.control: state.value for state in held.controls if state.value is not None}
    found["set"] = await right.keeper.apply(dict(wanted))
    found["exposures set"] = await right.exposures()
    found["too long"] = await right.keeper.apply({Control.EXPOSURE: 9000.0})
    found["auto"] = await right.keeper.apply({Control.EXPOSURE: "auto"})
    for task in tasks:
        task.cancel()
    await asyncio.gather(left.camera.stop(), right.camera.stop())
    return found


Path(sys.argv[1]).write_text(json.dumps(msgspec.to_builtins(asyncio.run(main()), str_keys=True)))
