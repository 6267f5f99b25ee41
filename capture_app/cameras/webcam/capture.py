"""A webcam as OpenCV opens it: frames and the host's time of their arrival; all calls block."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from capture_app.cameras.options import read_number, refuse_unknown
from capture_app.errors import CameraError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

OPTIONS = {
    "width": "pixels of the picture; a webcam may choose another size",
    "height": "the same",
    "fps": "frames a second; a webcam may choose another rate",
}
_CAMERA = "a webcam"
USUAL_FPS = 30.0
MOST_FPS = 1000.0


@dataclass(frozen=True, slots=True)
class WebcamRequest:
    """What a user asked for; None where the webcam's own choice will do."""

    width: int | None = None
    height: int | None = None
    fps: float | None = None


class Webcam:
    """An open webcam, which streams from then on."""

    def __init__(self, index: int, request: WebcamRequest) -> None:
        """Open it by its number. Raises CameraError where there is none, or it is in use."""
        import cv2

        self.index = index
        before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            self._capture: Any = cv2.VideoCapture(index)
        finally:
            cv2.utils.logging.setLogLevel(before)
        if not self._capture.isOpened():
            raise CameraError(
                f"webcam {index} does not open",
                hint="it is not there, in use, or this program may not use cameras (the system's settings)",
            )
        for prop, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, request.width),
            (cv2.CAP_PROP_FRAME_HEIGHT, request.height),
            (cv2.CAP_PROP_FPS, request.fps),
        ):
            if value is not None:
                self._capture.set(prop, value)
        told = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.fps = told if 0.1 <= told <= MOST_FPS else request.fps or USUAL_FPS

    def next_frame(self) -> "tuple[int, NDArray[np.uint8]] | None":
        """Wait for a frame: when it came in ns of the host's clock, and BGR (H, W, 3); None without one."""
        if not self._capture.grab():
            return None
        arrived_ns = time.monotonic_ns()
        good, image = self._capture.retrieve()
        return (arrived_ns, image) if good else None

    def close(self) -> None:
        """Let go of it."""
        self._capture.release()


def parse_options(options: Mapping[str, str]) -> WebcamRequest:
    """Read a spec's options. Raises BadInputError, naming the wrong one."""
    refuse_unknown(options, OPTIONS, _CAMERA)
    width = read_number(options, "width", _CAMERA, least=1, most=1 << 16)
    height = read_number(options, "height", _CAMERA, least=1, most=1 << 16)
    return WebcamRequest(
        width=None if width is None else round(width),
        height=None if height is None else round(height),
        fps=read_number(options, "fps", _CAMERA, least=0.1, most=MOST_FPS),
    )
