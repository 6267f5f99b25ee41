"""What the driver uses of OpenCV, as its documentation and the sources of 5.0 describe it for each system."""

import time
from typing import Any

import cv2
import numpy as np

BACKENDS = {"win32": cv2.CAP_DSHOW, "darwin": cv2.CAP_AVFOUNDATION, "linux": cv2.CAP_V4L2}
BUFFERS = {cv2.CAP_DSHOW: 1, cv2.CAP_AVFOUNDATION: 0, cv2.CAP_V4L2: 4}
"""Frames that wait for a program which is busy. AVFoundation's condition is waited for anew each time."""


class FakeCapture:
    """A camera behind one backend, at 50 frames a second."""

    def __init__(self, backend: int, *, is_open: bool = True, jpeg: bytes = b"", fps: float = 50.0) -> None:
        self.backend, self.is_open, self.jpeg, self.period_s = backend, is_open, jpeg, 1 / fps
        self.settings = {
            cv2.CAP_PROP_FRAME_WIDTH: 640.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
            cv2.CAP_PROP_FPS: 30.0,
            cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"YUY2")),
            cv2.CAP_PROP_CONVERT_RGB: 1.0,
        }
        self.is_silent = self.was_released = False
        self.stalls_s: dict[int, float] = {}
        """Times for which the program gets no processor, by the number of the read after them."""
        self.begun_s: float | None = None
        self.taken = 0
        self.arrived_ns: list[int] = []
        """When each frame that was read had arrived."""

    def isOpened(self) -> bool:
        return self.is_open

    def get(self, setting: int) -> float:
        if self.backend == cv2.CAP_AVFOUNDATION and setting == cv2.CAP_PROP_FOURCC:
            return -1.0  # CAP_PROP_UNKNOWN
        return self.settings[setting]

    def set(self, setting: int, value: float) -> bool:
        unknown = (cv2.CAP_PROP_FOURCC, cv2.CAP_PROP_CONVERT_RGB)
        if self.backend == cv2.CAP_AVFOUNDATION and setting in unknown:
            return False
        if self.backend == cv2.CAP_DSHOW and setting in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FPS):
            # The device is set up again, and not with the format that it had.
            self.settings[cv2.CAP_PROP_FOURCC] = float(cv2.VideoWriter.fourcc(*"YUY2"))
        self.settings[setting] = value
        return True

    def read(self) -> tuple[bool, Any]:
        if self.is_silent or self.was_released:
            time.sleep(0.005)
            return False, None
        begun_s = self.begun_s = time.monotonic() if self.begun_s is None else self.begun_s
        time.sleep(self.stalls_s.get(len(self.arrived_ns), 0.0))
        waiting = int((time.monotonic() - begun_s) / self.period_s) - self.taken
        if waiting > BUFFERS[self.backend] and self.backend == cv2.CAP_AVFOUNDATION:
            self.taken += waiting
        self.taken += 1
        due_s = begun_s + self.taken * self.period_s
        time.sleep(max(0.0, due_s - time.monotonic()))
        if self.backend == cv2.CAP_DSHOW:
            # The sample that is there is kept; those that come until it is taken are dropped.
            self.taken = max(self.taken, int((time.monotonic() - begun_s) / self.period_s))
        self.arrived_ns.append(round(due_s * 1e9))
        width, height = (
            int(self.settings[side]) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        if self.backend == cv2.CAP_V4L2 and not self.settings[cv2.CAP_PROP_CONVERT_RGB]:
            return True, np.frombuffer(self.jpeg, np.uint8)[None]
        return True, np.full((height, width, 3), self.taken % 200, np.uint8)

    def release(self) -> None:
        self.was_released = True
