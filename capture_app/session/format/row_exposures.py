"""When each row of a rolling-shutter image was exposed, from the session's record of the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capture_app.session.format.manifest import CameraRecord, ImageRecord

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class RowExposures:
    """The exposure of an image's rows in leader time, ns; row 0 is the top one and is read first."""

    first_start_ns: int
    exposure_ns: int
    row_time_ns: int
    rows: int

    def start_ns(self, row: int) -> int:
        """When the exposure of a row begins."""
        return self.first_start_ns + row * self.row_time_ns

    def middle_ns(self, row: int) -> int:
        """The middle of a row's exposure: the moment that its pixels show."""
        return self.start_ns(row) + self.exposure_ns // 2

    def middles_ns(self) -> NDArray[np.int64]:
        """The middles of all rows' exposures, (rows,)."""
        import numpy as np  # slow to import, and this module is in every command's way

        return self.middle_ns(0) + self.row_time_ns * np.arange(self.rows, dtype=np.int64)


def row_exposures(camera: CameraRecord, image: ImageRecord) -> RowExposures | None:
    """When the rows of an image were exposed; None where its start, exposure or row time is not known."""
    row_time_ns, rows = camera.facts.row_time_ns, camera.facts.height
    if image.exposure_start_ns is None or image.exposure_ns is None or row_time_ns is None:
        return None
    return RowExposures(image.exposure_start_ns, image.exposure_ns, row_time_ns, rows)
