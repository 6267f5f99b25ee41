"""What the studies of a comparison found, as `metrics.json` holds it: depth, panoramas, poses."""

from msgspec import Struct


class Interval(Struct, frozen=True, kw_only=True):
    """A median over the instants, and the middle 95 % of its bootstrap over them."""

    value: float
    low: float
    high: float


class Picture(Struct, frozen=True, kw_only=True):
    """One picture of the comparison: paths relative to the output folder."""

    key: str
    title: str
    synced: str
    offset: str
    caption: str = ""
    panels: int = 1
    """Panels side by side within each file; a slider over more than one would mix them."""


class DepthScores(Struct, frozen=True, kw_only=True):
    """Stereo depth in one condition: medians over the instants.

    Shares are of all pixels of that kind at an instant, empty ones counted as wrong.

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
    mover_photometric_error: float | None = None
    """Median absolute grey-level difference after warping one view onto the other by its depth."""
    static_photometric_error: float | None = None
    intervals: dict[str, Interval] = {}
    """By measure, where there are enough instants."""
    instants: int = 0

    @property
    def found_shares(self) -> tuple[float | None, float | None]:
        """The share of moving and of still pixels found, correctly where the truth is known."""
        if self.mover_within_2pct is not None:
            return self.mover_within_2pct, self.static_within_2pct
        return self.mover_coverage, self.static_coverage

    def interval_of(self, measure: str) -> Interval | None:
        """A measure with its interval, which has no width if there are too few instants."""
        value: float | None = getattr(self, measure)
        if value is None:
            return None
        return self.intervals.get(measure) or Interval(value=value, low=value, high=value)


class StereoComparison(Struct, frozen=True, kw_only=True):
    """Depth from a rectified pair, synchronized and offset."""

    reference: str
    other: str
    synced: DepthScores
    offset: DepthScores
    offset_ms: float | None = None
    """How much later the second camera is in fact; None where that is drawn for each instant."""
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    differences: dict[str, Interval] = {}
    """Offset minus synced by measure, paired by instant."""
    pictures: tuple[Picture, ...] = ()
    reason: str = ""
    """Why this pair was taken."""

    @property
    def cameras(self) -> tuple[str, str]:
        """Both, as the other studies have theirs."""
        return self.reference, self.other


class MultiviewScores(DepthScores, frozen=True, kw_only=True):
    """Depth of the reference camera by all of them, in one condition, and the cloud fused from all maps."""

    mover_consistency: float | None = None
    """Share of pixels whose depth two other cameras found too, each by itself, before any other check."""
    static_consistency: float | None = None
    mover_points: float | None = None
    """Fused points on moving things, of an instant."""
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


class InstantClouds(Struct, frozen=True, kw_only=True):
    """The fused clouds of one instant: paths of PLY files in the rig's frame, and whence they are shown."""

    instant: int
    synced: str
    offset: str
    rotation: tuple[float, ...]
    """Of the reference camera, from the rig's frame to its own, row by row."""
    centre: tuple[float, ...]
    """Where it stands."""
    focal: float
    """Its focal length over its pictures' width."""
    pivot: tuple[float, ...]
    """What a viewer turns about: the middle of what moves."""


class MultiviewComparison(Struct, frozen=True, kw_only=True):
    """Depth from all cameras, synchronized and with every camera off by another time.

    Judged on the camera in the middle, the reference, whose own picture is the same in both.
    """

    reference: str
    cameras: tuple[str, ...]
    synced: MultiviewScores
    offset: MultiviewScores
    offsets_ms: dict[str, float] = {}
    """How late each camera is against the reference; empty where it is drawn for each instant."""
    tolerance_m: float | None = None
    """How near a fused point and a true surface must be for the F-score; None where no truth is known."""
    width_px: int = 0
    """Of the reference's picture as it was matched: large ones are made smaller for a comparison."""
    matcher: str = ""
    """sweep or patchmatch."""
    matcher_note: str = ""
    """Why that one, or on which GPU."""
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    """Keys as in StereoComparison.per_instant, and `synced_mover_points` and `offset_mover_points`."""
    differences: dict[str, Interval] = {}
    """Offset minus synced by measure, paired by instant."""
    pictures: tuple[Picture, ...] = ()
    """Their offset side is not that of the pair: it is every camera off by another time."""
    clouds: InstantClouds | None = None
    """Of the instant that the pictures show; None where no cloud was fused."""
    left_out: dict[str, str] = {}
    """Cameras without depth, and why."""
    cloud_skipped: str = ""
    """Why there is no fused cloud, or no F-score of it."""


class TriangulationScores(Struct, frozen=True, kw_only=True):
    """Single points that COLMAP placed under the rig's poses, in one condition: medians over the instants."""

    mover_points: float | None
    """Points on moving things, of an instant; None where nothing moves."""
    static_points: float | None
    mover_reprojection_px: float | None = None
    """How far a point lies from where its cameras see it, px of their pictures; median over the points."""
    static_reprojection_px: float | None = None
    mover_precision: float | None = None
    """Share of the points whose distance is within 2 % of the truth, where that is known."""
    static_precision: float | None = None
    intervals: dict[str, Interval] = {}
    """By measure, where there are enough instants."""
    instants: int = 0


class TriangulationComparison(Struct, frozen=True, kw_only=True):
    """COLMAP's points, synchronized and offset: of two cameras one is late, of more each by another time."""

    cameras: tuple[str, ...]
    synced: TriangulationScores
    offset: TriangulationScores
    offsets_ms: dict[str, float] = {}
    """How late each camera is against the first; empty where it is drawn for each instant."""
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    """`instant`, `offset_CAMERA_ms`, and each measure as `synced_*` and `offset_*`."""
    differences: dict[str, Interval] = {}
    """Offset minus synced by measure, paired by instant."""
    left_out: tuple[str, ...] = ()
    """Calibrated cameras that did not take part: a few are enough to compare conditions."""


class PanoramaScores(Struct, frozen=True, kw_only=True):
    """A panorama in one condition, judged in the overlap before seams and blending.

    Misfit is how far off the second picture shows a point of the first, px: the median over points with
    structure that are found again there and back. Movers are points on what moves in the first picture.
    """

    overlap_misfit_px: float | None = None
    """Of all points."""
    static_misfit_px: float | None = None
    mover_misfit_px: float | None = None
    mover_found: float | None = None
    """Share of the points that are found again."""
    static_found: float | None = None
    mover_points: float | None = None
    """Points that it was measured at, of an instant."""
    static_points: float | None = None
    static_overlap_mad: float | None = None
    """Mean absolute grey-level difference on static pixels of the overlap (0-255)."""
    mover_overlap_mad: float | None = None
    """On pixels where something moves in either picture."""
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


class PoseScores(Struct, frozen=True, kw_only=True):
    """Where the cameras stand, found from the pictures of single instants alone, in one condition.

    A pair is placed right where both cameras were placed, and the rotation between them and the direction
    from one to the other are within `PoseComparison.tolerance_deg` of the true ones.
    """

    registered: float
    """Cameras that were placed at an instant."""
    correct_pairs: float
    """Share of all pairs of cameras that were placed right at an instant."""
    rotation_deg: float | None = None
    """Error of the rotation between two cameras, the median over the pairs that were placed; degrees."""
    direction_deg: float | None = None
    """Error of the direction from one camera to the other, the same; degrees."""
    intervals: dict[str, Interval] = {}
    """By measure, where there are enough instants."""
    instants: int = 0


class PoseComparison(Struct, frozen=True, kw_only=True):
    """Poses found instant by instant, synchronized and with every camera off by another time."""

    cameras: tuple[str, ...]
    synced: PoseScores
    offset: PoseScores
    degraded: bool
    """Lateness costs more than a tenth of the pairs that are placed right."""
    tolerance_deg: float
    truth_source: str
    """What the poses are compared with."""
    offsets_ms: dict[str, float] = {}
    """As in MultiviewComparison."""
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    """`instant`, and each measure of PoseScores as `synced_*` and `offset_*`."""
    differences: dict[str, Interval] = {}
    reason: str = ""
    """Why poses were looked at."""
