"""A session's own `calibration.json`."""

from pathlib import Path

import numpy as np

from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.checks import read_struct
from capture_app.session.importers.calibrations.camera_views import View, Views


def read_own(path: Path) -> Views:
    """Read a `calibration.json` as docs/session-format.md describes it. Raises BadInputError if broken."""
    calibration = read_struct(path, Calibration, 1)
    views = {name: _view(camera) for name, camera in calibration.cameras.items()}
    return Views(views, calibration.source or path.name, calibration.unit)


def _view(camera: CameraCalibration) -> View:
    return View(
        matrix=np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64),
        distortion=np.array(camera.distortion, np.float64),
        rotation=np.array(camera.rotation, np.float64),
        translation=np.array(camera.translation, np.float64),
        size=(camera.width, camera.height),
    )
