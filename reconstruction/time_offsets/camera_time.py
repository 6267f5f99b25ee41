"""Measured time offset of one camera, in the form that every measuring method returns."""

from msgspec import Struct, structs

DIGITS = {"offset_ms": 3, "sd_ms": 3, "row_time_ns": None, "row_time_sd_ns": None, "misfit_px": 1}
"""Decimal places to which each field is rounded; None: a whole number."""


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
    rate_ppm: float | None = None
    """Rate correction that a recording without common times needs to match the reference's clock, ppm."""
    rate_sd_ppm: float | None = None
    at_ms: float | None = None
    """Time on the camera's own clock at which the offset holds."""
    row_time_ns: float | None = None
    """Readout time of one row, measured from the images."""
    row_time_sd_ns: float | None = None

    def rounded(self) -> "CameraTime":
        """Return a copy rounded to the decimal places in `DIGITS`."""
        known = {name: value for name in DIGITS if (value := getattr(self, name)) is not None}
        return structs.replace(self, **{name: round(value, DIGITS[name]) for name, value in known.items()})
