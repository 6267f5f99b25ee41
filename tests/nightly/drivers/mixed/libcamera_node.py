"""A program: `capture-app` on a machine whose libcamera is the double, one sensor in real time.

The first argument is a file that gets the true start of each frame's exposure, in the host's clock.
"""

import sys
from pathlib import Path
from types import ModuleType

from capture_app.cli import run
from capture_app.common.host_clock import host_from_monotonic
from tests.unit.plugins.cameras.libcamera.double import libcamera_double
from tests.unit.plugins.cameras.libcamera.double_camera import Frame, Sensor


class TrueStarts(list[Frame]):
    """The frames of a sensor, written down as they are delivered."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file = file.open("a", buffering=1)

    def append(self, frame: Frame) -> None:
        """Write one down."""
        self._file.write(f"{host_from_monotonic(frame.exposed_from_ns)}\n")


if __name__ == "__main__":
    library = libcamera_double(Sensor(ppm=30.0))
    library.CameraManager.singleton().cameras[0].frames = TrueStarts(Path(sys.argv[1]))
    module = ModuleType("libcamera")
    vars(module).update(vars(library))
    sys.modules["libcamera"] = module
    sys.exit(run(sys.argv[2:]))
