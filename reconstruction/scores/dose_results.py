"""Depth against offset, as `reconstruct dose` writes it."""

from msgspec import Struct

from reconstruction.scores.depth_results import DepthScores


class DosePoint(Struct, frozen=True, kw_only=True):
    """Depth with the second camera so much later; shares as in DepthScores, with intervals."""

    offset_ms: float
    offset_frames: int
    scores: DepthScores


class DoseResult(Struct, frozen=True, kw_only=True):
    """A pair's depth against offset, on the same instants and by the same calibration throughout."""

    reference: str
    other: str
    measure: str
    """What the curve shows: mover_within_2pct where truth is known, else mover_coverage."""
    points: tuple[DosePoint, ...]
    instants: int
    decreasing: bool
    """No point's interval lies wholly above its predecessor's."""
    tolerable_offset_ms: float | None = None
    """The offset at which the curve has lost a tenth (linear between its points), or at which half of what
    moves has moved by one pixel, whichever comes first."""
    speed_px_per_ms: float | None = None
    """How fast what moves does so in the reference's picture, the median over its pixels."""
    sync_residual_us: float | None = None
    """The session's own largest error of an image's time by its record."""
    sync_residual_px: float | None = None
    """By how much what moves does so in that time."""
    reason: str = ""
    session: str = ""
    calibration: str = ""
    report: str = ""
    seconds: float = 0.0
    versions: dict[str, str] = {}
