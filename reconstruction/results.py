"""What a comparison found: the contents of `metrics.json`, and the pictures that show it."""

from msgspec import Struct


class _Result(Struct, frozen=True, kw_only=True):
    """Base of all results."""


class DepthScores(_Result, frozen=True, kw_only=True):
    """Stereo depth in one condition; shares are of all pixels of that kind, empty ones counted as wrong.

    Movers are pixels of moving things, static ones the rest. `*_within_2pct` need ground truth.
    """

    mover_coverage: float | None
    static_coverage: float | None
    mover_within_2pct: float | None = None
    static_within_2pct: float | None = None
    mover_epipolar_px: float | None = None
    """Median vertical disparity of matches on movers, in px of the rectified images."""
    static_epipolar_px: float | None = None
    mover_photometric: float | None = None
    """Median absolute grey-level difference after warping one view onto the other by its depth."""
    static_photometric: float | None = None
    instants: int = 0


class Picture(_Result, frozen=True, kw_only=True):
    """One picture of the comparison: paths relative to the output folder."""

    key: str
    title: str
    synced: str
    offset: str
    caption: str = ""
    panels: int = 1
    """Panels side by side within each file; a slider over more than one would mix them."""


class StereoResult(_Result, frozen=True, kw_only=True):
    """Depth from a rectified pair, synchronized and offset."""

    reference: str
    other: str
    synced: DepthScores
    offset: DepthScores
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    why: str = ""
    """Why this pair was taken."""


class StitchScores(_Result, frozen=True, kw_only=True):
    """A panorama in one condition, judged in the overlap before blending."""

    overlap_flow_p95_px: float
    static_overlap_mad: float
    """Mean absolute grey-level difference on static pixels of the overlap (0-255)."""
    mover_overlap_mad: float | None = None
    mover_flow_p95_px: float | None = None
    """As overlap_flow_p95_px, on moving things only."""
    instants: int = 0


class StitchResult(_Result, frozen=True, kw_only=True):
    """A panorama registered once and composed for each condition."""

    cameras: tuple[str, ...]
    synced: StitchScores
    offset: StitchScores
    why: str = ""
    """Why this pair was taken."""


class CompareResult(_Result, frozen=True, kw_only=True):
    """Everything `reconstruct compare` found; written as `metrics.json` and printed by --json."""

    session: str
    offset_ms: float
    """The offset that was asked for."""
    offset_frames: int
    actual_offset_ms: float
    verdict: str
    """One or two plain sentences for somebody who has never heard of synchronization."""
    calibration: str
    """Where the calibration came from."""
    stereo: StereoResult | None = None
    stitch: StitchResult | None = None
    stereo_skipped: str = ""
    stitch_skipped: str = ""
    sync_residual_us: float | None = None
    """Largest distance of an image from its instant, by the session's own record."""
    sync_bound_us: float | None = None
    pictures: tuple[Picture, ...] = ()
    report: str = ""
    seconds: float = 0.0
    versions: dict[str, str] = {}
