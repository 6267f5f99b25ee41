"""Panel readings of one camera's images; an unknown exposure and row time are learned from the first ones."""

from statistics import median

import numpy as np
from numpy.typing import NDArray

from capture_app.companions.panel.time_reading import PanelTime, read_panel

_LEARN = 3
"""Images whose unknown exposure and row time are estimated separately."""
_MAX_LENGTH_RATIO = 0.1
"""Estimated exposures that differ by at most this fraction are taken as one exposure for all images."""


class CameraReading:
    """Reader of the panel in a camera's images."""

    def __init__(self) -> None:
        """Create a reader that has learned nothing yet."""
        self._learned: list[PanelTime] = []

    def read(
        self,
        picture: NDArray[np.uint8],
        *,
        exposure_ns: float | None = None,
        row_time_ns: float | None = None,
    ) -> PanelTime:
        """Read an image (uint8, BGR); unknown values are None. Raises PanelNotFoundError as `read_panel`."""
        if (exposure_ns is None or row_time_ns is None) and len(self._learned) < _LEARN:
            self._learned.append(read_panel(picture, exposure_ns=exposure_ns, row_time_ns=row_time_ns))
            return self._learned[-1]
        exposures = [reading.shutter.exposure_ns for reading in self._learned]
        if exposure_ns is None and max(exposures) / min(exposures) < 1 + _MAX_LENGTH_RATIO:
            exposure_ns = round(median(exposures))
        # An unknown row time stays free: its uncertainty is part of each reading's uncertainty.
        return read_panel(picture, exposure_ns=exposure_ns, row_time_ns=row_time_ns)
