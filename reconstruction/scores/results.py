"""What a comparison found: the contents of `metrics.json`, and the pictures that show it."""

from msgspec import Struct


class _Result(Struct, frozen=True, kw_only=True):
    """Base of all results."""


class Interval(_Result, frozen=True, kw_only=True):
    """A value and the middle 95 % of its bootstrap over the instants."""

    value: float
    low: float
    high: float


class DepthScores(_Result, frozen=True, kw_only=True):
    """Stereo depth in one condition; shares are of all pixels of that kind, empty ones counted as wrong.

    Movers are pixels of moving things, static ones the rest. `*_within_*pct` need ground truth.
    """

    mover_coverage: float | None
    static_coverage: float | None
    mover_within_1pct: float | None = None
    static_within_1pct: float | None = None
    mover_within_2pct: float | None = None
    static_within_2pct: float | None = None
    mover_within_5pct: float | None = None
    static_within_5pct: float | None = None
    mover_epipolar_px: float | None = None
    """Median vertical disparity of matches on movers, in px of the rectified images."""
    static_epipolar_px: float | None = None
    mover_photometric: float | None = None
    """Median absolute grey-level difference after warping one view onto the other by its depth."""
    static_photometric: float | None = None
    intervals: dict[str, Interval] = {}
    """By measure, where there are enough instants."""
    instants: int = 0


class StereoResult(_Result, frozen=True, kw_only=True):
    """Depth from a rectified pair, synchronized and offset."""

    reference: str
    other: str
    synced: DepthScores
    offset: DepthScores
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    differences: dict[str, Interval] = {}
    """Offset minus synced by measure, paired by instant."""
    why: str = ""
    """Why this pair was taken."""


class Picture(_Result, frozen=True, kw_only=True):
    """One picture of the comparison: paths relative to the output folder."""

    key: str
    title: str
    synced: str
    offset: str
    caption: str = ""
    panels: int = 1
    """Panels side by side within each file; a slider over more than one would mix them."""


class MultiviewScores(DepthScores, frozen=True, kw_only=True):
    """Depth of the reference camera by all of them, in one condition, and the cloud fused from all maps."""

    mover_consistency: float | None = None
    """Share of pixels whose depth two other cameras found too, each for itself, before any other check."""
    static_consistency: float | None = None
    mover_points: float | None = None
    """Fused points on moving things, of an instant; the mean over the instants."""
    static_points: float | None = None
    mover_f_score: float | None = None
    """Of the fused cloud against the true surfaces of the instant, within the comparison's tolerance."""
    static_f_score: float | None = None
    mover_precision: float | None = None
    """Share of the fused points that lie on a true surface."""
    static_precision: float | None = None
    mover_recall: float | None = None
    """Share of the true surfaces, as far as two cameras see them, that have a fused point."""
    static_recall: float | None = None


class MultiviewComparison(_Result, frozen=True, kw_only=True):
    """Depth from all cameras, synchronized and with every camera off by another time.

    Judged on the camera in the middle, the reference, whose own picture is the same in both.
    """

    reference: str
    cameras: tuple[str, ...]
    synced: MultiviewScores
    offset: MultiviewScores
    offsets_ms: dict[str, float] = {}
    """How late each camera is against the reference; empty where it is drawn anew for each instant."""
    tolerance_m: float | None = None
    """How near a fused point and a true surface must be for the F-score; None where no truth is known."""
    width_px: int = 0
    """Of the reference's picture as it was matched: large ones are made smaller for a comparison."""
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    """Keys as in StereoResult.per_instant, and `synced_mover_points` and `offset_mover_points`."""
    differences: dict[str, Interval] = {}
    """Offset minus synced by measure, paired by instant."""
    pictures: tuple[Picture, ...] = ()
    """Their offset side is not that of the pair: it is every camera off by another time."""
    left_out: dict[str, str] = {}
    """Cameras without depth, and why."""
    cloud_skipped: str = ""
    """Why there is no fused cloud, or no F-score of it."""


class PoseScores(_Result, frozen=True, kw_only=True):
    """Where the cameras stand, found from the pictures of single instants alone, in one condition.

    A pair is placed right where both cameras were placed, and the rotation between them and the direction
    from one to the other are within `PoseComparison.right_deg` of the true ones.
    """

    registered: float
    """Cameras that were placed at an instant; the mean over the instants."""
    right_pairs: float
    """Share of all pairs of cameras that were placed right."""
    rotation_deg: float | None = None
    """Error of the rotation between two cameras, the median over the pairs that were placed; degrees."""
    direction_deg: float | None = None
    """Error of the direction from one camera to the other, likewise."""
    intervals: dict[str, Interval] = {}
    """By measure, where there are enough instants."""
    instants: int = 0


class PoseComparison(_Result, frozen=True, kw_only=True):
    """Poses found instant by instant, synchronized and with every camera off by another time."""

    cameras: tuple[str, ...]
    synced: PoseScores
    offset: PoseScores
    harmed: bool
    """Lateness costs more than a tenth of the pairs that are placed right."""
    right_deg: float
    truth: str
    """What the poses are held against."""
    offsets_ms: dict[str, float] = {}
    """As in MultiviewComparison."""
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    """`instant`, and each measure of PoseScores as `synced_*` and `offset_*`."""
    differences: dict[str, Interval] = {}
    why: str = ""
    """Why poses were looked at."""


class StitchScores(_Result, frozen=True, kw_only=True):
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


class StitchResult(_Result, frozen=True, kw_only=True):
    """A panorama registered once and composed for each condition."""

    cameras: tuple[str, ...]
    synced: StitchScores
    offset: StitchScores
    differences: dict[str, Interval] = {}
    """Offset minus synced by measure, paired by instant."""
    why: str = ""
    """Why this pair was taken."""


class DosePoint(_Result, frozen=True, kw_only=True):
    """Depth with the second camera so much later; shares as in DepthScores, with intervals."""

    offset_ms: float
    offset_frames: int
    scores: DepthScores


class DoseResult(_Result, frozen=True, kw_only=True):
    """A pair's depth against offset, on the same instants and by the same calibration throughout."""

    reference: str
    other: str
    measure: str
    """What the curve shows: mover_within_2pct where truth is known, else mover_coverage."""
    points: tuple[DosePoint, ...]
    instants: int
    falls: bool
    """No point's interval lies wholly above its predecessor's."""
    bearable_ms: float | None = None
    """The offset at which the curve has lost a tenth (linear between its points), or at which half of what
    moves has moved by one pixel, whichever comes first."""
    speed_px_per_ms: float | None = None
    """How fast what moves does so in the reference's picture, the median over its pixels."""
    own_error_us: float | None = None
    """The session's own largest error of an image's time by its record."""
    own_error_px: float | None = None
    """By how much what moves does so in that time."""
    why: str = ""
    session: str = ""
    calibration: str = ""
    report: str = ""
    seconds: float = 0.0
    versions: dict[str, str] = {}


class BurstGrid(_Result, frozen=True, kw_only=True):
    """Small pictures of the burst: a row for each camera, a column for each instant; "" = no image."""

    cameras: tuple[str, ...]
    instants: tuple[int, ...]
    times_ms: tuple[float, ...]
    """Since the burst's first instant."""
    thumbnails: tuple[tuple[str, ...], ...]


class BulletTime(_Result, frozen=True, kw_only=True):
    """One instant from camera to camera, synchronized and with cameras late: paths of pictures by camera."""

    cameras: tuple[str, ...]
    """In the order of the sweep."""
    instant: int
    synced: tuple[str, ...]
    offset: tuple[str, ...]
    late_ms: tuple[float, ...]
    """How late each camera's offset picture is."""
    steady: bool
    """The pictures are turned and zoomed so that what moves stays where it is."""
    by_place: bool
    """The order is that of the cameras' places, not of their names."""
    file: str
    """An animation of both side by side."""
    synced_step_px: float | None = None
    """How far the largest thing that moves goes from one picture to the next at most, px of the pictures;
    None where they are not held steady."""
    offset_step_px: float | None = None


class ConditionResult(_Result, frozen=True, kw_only=True):
    """A further condition beside the synchronized one, on the same pairs of cameras.

    In `stereo` and `stitch`, `synced` is the comparison's own session and `offset` this condition.
    """

    name: str
    offsets_ms: dict[str, float] = {}
    """How late each camera is; empty for another session."""
    session: str = ""
    """The other session that this condition is; it is not paired by instant."""
    stereo_offset_ms: float | None = None
    """How much later the pair's second camera is in fact; None where that is drawn anew for each instant."""
    stitch_offset_ms: float | None = None
    stereo: StereoResult | None = None
    stitch: StitchResult | None = None
    multiview: MultiviewComparison | None = None
    poses: PoseComparison | None = None
    skipped: tuple[str, ...] = ()


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
    multiview: MultiviewComparison | None = None
    poses: PoseComparison | None = None
    stereo_skipped: str = ""
    stitch_skipped: str = ""
    multiview_skipped: str = ""
    poses_skipped: str = ""
    sync_residual_us: float | None = None
    """Largest distance of an image from its instant, by the session's own record."""
    sync_bound_us: float | None = None
    pictures: tuple[Picture, ...] = ()
    conditions: tuple[ConditionResult, ...] = ()
    dose: DoseResult | None = None
    burst: BurstGrid | None = None
    bullet_time: BulletTime | None = None
    report: str = ""
    seconds: float = 0.0
    versions: dict[str, str] = {}
