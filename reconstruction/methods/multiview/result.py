"""Result of `reconstruct multiview`; written to multiview.json and printed by --json."""

from msgspec import Struct, field

from capture_app.session.format.calibration import LensKnowledge
from capture_app.session.reading.take_sheet import PAIR_DEPTH
from reconstruction.common.outputs import REPORT
from reconstruction.method.truth import DepthShares
from reconstruction.scene.calibration.consistency import (
    describe_residual,
    describe_sideways_error,
    no_measurement,
)
from reconstruction.scene.provenance import Provenance

RESULT = "multiview.json"
POINTS = "points.ply"
FILES = (POINTS, REPORT)
FUSED, WORKSPACE = "fused.ply", "workspace"
CONFIDENCE = "confidence"
"""Folder of the pictures of confidence, and the name of the maps in the files of depth."""
OURS = {
    *FILES,
    PAIR_DEPTH,
    RESULT,
    "depth",
    CONFIDENCE,
    WORKSPACE,
    FUSED,
    "cloud.ply",
    "mesh.ply",
    "mesh.glb",
    "turntable.png",
}
UNCERTAIN_SCALE = 0.005
"""Relative standard deviation of the scale from which it is reported: a quarter of depth's 2 %."""


class ViewResult(DepthShares, frozen=True, kw_only=True):
    """One camera's depth map, and its accuracy."""

    camera: str
    instant: int
    """Instant of the image; differs from the requested one if an offset was requested."""
    sources: tuple[str, ...]
    coverage: float
    """Fraction of the pixels that have a depth."""
    depth: str
    """File with `depth` (height x width, 0 = none) and `normals` (x 3, camera's frame)."""
    picture: str
    mover_coverage: float | None = None
    expected_within_2pct: float | None = None
    """Fraction of the pixels that are probably within 2 % of the true depth: the mean confidence."""
    expected_range: tuple[float, float] | None = None
    """95 % interval of that fraction; None = unknown, as in results of older versions.

    Of two cameras, its lower end is for one that is turned sideways by 1 px, which they do not show.
    """


class CloudScore(Struct, frozen=True, kw_only=True):
    """Score of a cloud's moving points against the true surfaces, with a tolerance of 1 cm."""

    points: int
    precision: float | None
    """Fraction of the points on a true surface; None with too few points."""
    recall: float
    """Fraction of the surfaces seen by at least two cameras that the cloud contains."""
    f_score: float
    """Harmonic mean of precision and recall."""


class MultiviewResult(Provenance, frozen=True, kw_only=True):
    """Depth of all cameras at an instant; the top-level fractions belong to the reference camera."""

    session: str
    instant: int
    offsets_ms: tuple[float, ...] = ()
    matcher: str
    matcher_note: str = ""
    """Reason for the choice of matcher."""
    calibration: str
    lenses: LensKnowledge = LensKnowledge()
    unit: str
    reference: str
    """Camera in the middle of the rig, whose image overlaps most with the others."""
    coverage: float
    expected_within_2pct: float | None = None
    expected_range: tuple[float, float] | None = None
    within_2pct: float | None = None
    mover_within_2pct: float | None = None
    static_within_2pct: float | None = None
    median_error_pct: float | None = None
    rest_error_px: float | None = None
    """Misfit of points at rest to the calibration, a standard deviation; None if they are too few."""
    rest_errors_px: dict[str, float] = field(default_factory=dict)
    """That misfit by camera."""
    rest_points: int = 0
    turn_error: float | None = None
    """Relative error of depth by a turn that two cameras do not show; None for more cameras."""
    scale_error: float = 0.0
    """Relative standard deviation of all distances by `--refine`, of which images do not show the scale."""
    movers_1cm: CloudScore | None = None
    """None if nothing moves, or the truth is not known in metres."""
    moving_measured: float | None = None
    """Fraction of moving pixels, by motion in the images, that have a depth; only with a page."""
    nearest: float
    farthest: float
    views: tuple[ViewResult, ...]
    left_out: dict[str, str] = field(default_factory=dict)
    """Cameras without depth, with the reasons."""
    fused_points: int
    cloud_points: int
    mesh_triangles: int
    files: tuple[str, ...]

    @property
    def basis(self) -> str:
        """What the depth rests on, in words: the fit of points at rest, the scale, and what that means."""
        if warning := no_measurement(self.lenses):
            return warning
        fit = describe_residual(
            self.rest_error_px,
            self.rest_points,
            expected=self.expected_within_2pct,
            expected_range=self.expected_range,
            errors_px=self.rest_errors_px,
        )
        if self.turn_error is not None:
            fit = f"{fit}; {describe_sideways_error(self.turn_error)}"
        if self.scale_error < UNCERTAIN_SCALE:
            return fit
        return (
            f"{fit}; warning: the poses were refined, of which images do not show the scale: all distances "
            f"may be wrong by the same {100 * self.scale_error:.1f} % (standard deviation); "
            "calibrate with a board to know it"
        )


class SequenceInstant(DepthShares, frozen=True, kw_only=True, omit_defaults=True):
    """One instant of a sequence; `reason` says why it has no cloud."""

    instant: int
    leader_ns: int
    cloud: str = ""
    points: int = 0
    reference: str = ""
    coverage: float | None = None
    movers_1cm: CloudScore | None = None
    left_out: dict[str, str] = field(default_factory=dict)
    """Cameras without depth, with the reasons."""
    seconds: float = 0.0
    reason: str = ""


class SequenceResult(Provenance, frozen=True, kw_only=True, omit_defaults=True):
    """Clouds of many instants, and this run; fractions are medians over the instants that have them."""

    session: str
    condition: str
    matcher: str
    calibration: str
    unit: str
    instants: tuple[SequenceInstant, ...]
    clouds: int
    kept: int = 0
    """Clouds reused from an earlier run that was stopped."""
    mover_f_score_1cm: float | None = None
    mover_within_2pct: float | None = None
    within_2pct: float | None = None
    masks: bool = False
    files: tuple[str, ...]
