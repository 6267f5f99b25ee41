"""Panoramas in a comparison, as `metrics.json` holds them."""

from msgspec import Struct

from reconstruction.scores.results import Interval, Picture


class PanoramaScores(Struct, frozen=True, kw_only=True):
    """A panorama in one condition, judged in the overlap before blending."""

    overlap_flow_p95_px: float
    static_overlap_mad: float
    """Mean absolute grey-level difference on static pixels of the overlap (0-255)."""
    mover_overlap_mad: float | None = None
    mover_flow_p95_px: float | None = None
    """As overlap_flow_p95_px, on moving things only."""
    intervals: dict[str, Interval] = {}
    """By measure, where there are enough instants."""
    instants: int = 0


class PanoramaComparison(Struct, frozen=True, kw_only=True):
    """A panorama registered once and composed for each condition."""

    cameras: tuple[str, ...]
    synced: PanoramaScores
    offset: PanoramaScores
    offset_ms: float | None = None
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    """`offset_ms` and `per_instant` as in StereoComparison."""
    differences: dict[str, Interval] = {}
    """Offset minus synced by measure, paired by instant."""
    pictures: tuple[Picture, ...] = ()
    reason: str = ""
    """Why this pair was taken."""
