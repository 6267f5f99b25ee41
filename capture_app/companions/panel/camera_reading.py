"""Panel readings of one camera's images; an unknown exposure and row time are learned from the first ones."""

import math
from dataclasses import replace
from functools import partial
from statistics import median

import numpy as np
from numpy.typing import NDArray

from capture_app.companions.panel.light_model import Shutter
from capture_app.companions.panel.time_reading import LONGEST, PanelTime, read_panel

_LEARN = 3
"""Images whose unknown exposure and row time are estimated separately."""
_MAX_LENGTH_RATIO = 0.1
"""Estimated exposures that differ by at most this fraction are taken as one exposure for all images."""


class CameraReading:
    """Reader of the panel in a camera's images."""

    def __init__(self, frame_limits: Shutter | None = None) -> None:
        """Create a reader; `frame_limits` are a video's longest exposure and row time.

        All frames of a video that are read have one shutter. None: single images, each with its own.
        """
        self._learned: list[PanelTime] = []
        self._limits = frame_limits

    def read(
        self,
        picture: NDArray[np.uint8],
        *,
        exposure_ns: float | None = None,
        row_time_ns: float | None = None,
    ) -> PanelTime:
        """Read an image (uint8, BGR); unknown values are None. Raises PanelNotFoundError as `read_panel`."""
        read = partial(read_panel, picture, longest=self._limits or LONGEST)
        if (exposure_ns is None or row_time_ns is None) and len(self._learned) < _LEARN:
            self._learned.append(read(exposure_ns=exposure_ns, row_time_ns=row_time_ns))
            return self._learned[-1]
        exposures = [reading.shutter.exposure_ns for reading in self._learned]
        is_one = self._limits or (exposures and max(exposures) / min(exposures) < 1 + _MAX_LENGTH_RATIO)
        if exposure_ns is None and is_one:
            exposure_ns = round(median(exposures))
        if row_time_ns is not None or self._limits is None:
            # An unknown row time stays free: its uncertainty is part of each reading's uncertainty.
            return read(exposure_ns=exposure_ns, row_time_ns=row_time_ns)
        row_time_ns = median(reading.shutter.row_time_ns for reading in self._learned)
        error_ns = median(reading.row_time_error_ns for reading in self._learned) / math.sqrt(_LEARN)
        # The first readings' uncertainty includes that of the shutter.
        least_ns = median(reading.uncertainty_ns for reading in self._learned)
        found = read(exposure_ns=exposure_ns, row_time_ns=row_time_ns)
        return replace(found, row_time_error_ns=error_ns, uncertainty_ns=max(found.uncertainty_ns, least_ns))
