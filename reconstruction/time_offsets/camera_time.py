"""How much later than its times say a camera's images were taken: what every way to measure it gives."""

from msgspec import Struct, structs

DIGITS = {"offset_ms": 3, "sd_ms": 3, "row_time_ns": None, "row_time_sd_ns": None}
"""Digits after the point that are told; None: a whole number."""


class CameraTime(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """How much later than its times say a camera's images were taken, against the reference's; or why not.

    By light: that of the first row, or of the middle one where the session tells no row time.
    """

    offset_ms: float | None = None
    sd_ms: float | None = None
    """A standard deviation."""
    source: str = ""
    """What it was measured by: light, motion, or reference."""
    against: tuple[str, ...] = ()
    """The cameras that what moves was compared with."""
    edges: int | None = None
    """Number of a lamp's edges by which it was measured."""
    reason: str = ""
    """Why it cannot be told."""
    rate_ppm: float | None = None
    """How much faster the times of a recording without common times must run to be the reference's."""
    rate_sd_ppm: float | None = None
    at_ms: float | None = None
    """The time of its own at which the offset is this one."""
    row_time_ns: float | None = None
    """What its pictures tell of the readout of a row."""
    row_time_sd_ns: float | None = None

    def rounded(self) -> "CameraTime":
        """With as many digits as are told."""
        known = {name: value for name in DIGITS if (value := getattr(self, name)) is not None}
        return structs.replace(self, **{name: round(value, DIGITS[name]) for name, value in known.items()})
