"""Times of a camera's images: as the session records them, and the offset that a method has measured."""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct, structs

from capture_app.session.format.manifest import row_exposures
from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.instant_votes import Change
from reconstruction.time_offsets.single_images import SingleImages

MAX_OFFSET_MS = 300.0
"""Maximum offset searched for."""


class CameraTime(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Delay of a camera's images against its recorded times, relative to the reference's delay.

    An offset measured by light holds for the first row, or for the middle row if the session has no row time.
    """

    offset_ms: float | None = None
    sd_ms: float | None = None
    """Standard deviation of the offset."""
    source: str = ""
    """What the offset was measured by: light, motion, or reference."""
    against: tuple[str, ...] = ()
    """The cameras with which its moving objects were compared."""
    edges: int | None = None
    """Number of lamp edges used for the measurement."""
    reason: str = ""
    """Why the offset could not be measured; empty if it was."""
    misfit_px: float | None = None
    """Median epipolar error of static points, if the calibration does not fit them. The offset was then
    measured with a geometry corrected by these points."""
    change: Change | None = None
    """How the offset changes over the take: dropped or repeated frames, or another frame rate."""
    jitter_ms: float | None = None
    """Standard deviation of single images' own offsets, if it is certainly not zero."""
    images: SingleImages = SingleImages()
    """Single images that are not at this offset, or do not show whether they are."""
    planned_ms: float = 0.0
    """Delay against the reference that was planned (staggered cameras); `offset_ms` is what is beyond it."""
    rate_ppm: float | None = None
    """Rate correction that a recording without common times needs to match the reference's clock, ppm."""
    rate_sd_ppm: float | None = None
    at_ms: float | None = None
    """Time on the camera's own clock at which the offset holds."""
    row_time_ns: float | None = None
    """Readout time of one row, measured from the images."""
    row_time_sd_ns: float | None = None

    def rounded(self) -> "CameraTime":
        """Return a copy in microseconds, tenths of a pixel and whole nanoseconds of row times."""
        digits = {
            "offset_ms": 3,
            "sd_ms": 3,
            "row_time_ns": None,
            "row_time_sd_ns": None,
            "misfit_px": 1,
            "jitter_ms": 1,
        }
        known = {name: value for name in digits if (value := getattr(self, name)) is not None}
        return structs.replace(self, **{name: round(value, digits[name]) for name, value in known.items()})


class ImageTimes:
    """Times of the rows of some cameras' images from the session's record, ms since its first instant.

    A row's time is its mid-exposure if all of these cameras record row exposures, else the image's one time.
    """

    def __init__(self, dataset: Dataset, cameras: Sequence[str]) -> None:
        self.dataset = dataset
        self._epoch_ns = dataset.instants_ns[0]
        rows = {
            (camera, k): row_exposures(dataset.session.camera(camera), dataset.record(camera, k))
            for camera in cameras
            for k in dataset.instants(camera)
        }
        self.by_rows = None not in rows.values()
        """Whether all of these cameras record row exposures."""
        self._rows = rows if self.by_rows else {}

    def at_ms(self, camera: str, instant: int) -> float:
        """Return the single time that the session records for an image, ms."""
        return (self.dataset.record(camera, instant).leader_ns - self._epoch_ns) / 1e6

    def middle_ms(self, camera: str, instant: int) -> float:
        """Return the time of the image's middle row."""
        return float(self.of_rows_ms(camera, instant, np.array([self.dataset.size(camera)[1] / 2]))[0])

    def of_rows_ms(self, camera: str, instant: int | None, rows: Array) -> Array:
        """Return the times of rows (n,), px from the top; NaN if there is no image (None)."""
        if instant is None:
            return np.full(len(rows), np.nan)
        if (known := self._rows.get((camera, instant))) is None:
            return np.full(len(rows), self.at_ms(camera, instant))
        start_ms = (known.middle_ns(0) - self._epoch_ns) / 1e6
        # Reduced images have fewer rows than the camera read out.
        row_ms = known.row_time_ns / 1e6 * known.rows / self.dataset.size(camera)[1]
        return np.asarray(start_ms + row_ms * rows)
