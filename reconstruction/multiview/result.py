"""What `reconstruct multiview` found; written as multiview.json and printed by --json."""

from msgspec import Struct, field

from reconstruction.common.outputs import Provenance
from reconstruction.scores.truth import DepthShares


class ViewResult(DepthShares, frozen=True, kw_only=True):
    """One camera's depth map, and how right it is."""

    camera: str
    instant: int
    """The instant of its image: another than asked for where an offset was asked for."""
    sources: tuple[str, ...]
    coverage: float
    """Share of its pixels that have a depth."""
    depth: str
    """File with `depth` (height x width, 0 = none) and `normals` (x 3, camera's frame)."""
    picture: str
    mover_coverage: float | None = None


class CloudScore(Struct, frozen=True, kw_only=True):
    """What moves in a cloud against the true surfaces: within 1 cm is right, and found."""

    points: int
    precision: float | None
    """Share of its points that lie on a true surface; None of a few points."""
    recall: float
    """Share of the surfaces that at least two cameras see which the cloud has."""
    f_score: float
    """Their harmonic mean."""


class MultiviewResult(Provenance, frozen=True, kw_only=True):
    """Depth of all cameras of an instant; the first shares are those of the reference camera."""

    session: str
    instant: int
    offsets_ms: tuple[float, ...] = ()
    matcher: str
    matcher_note: str = ""
    """Why this matcher was taken."""
    calibration: str
    unit: str
    reference: str
    """The camera in the middle of the rig, whose picture the others share most of."""
    coverage: float
    within_2pct: float | None = None
    mover_within_2pct: float | None = None
    static_within_2pct: float | None = None
    median_error_pct: float | None = None
    movers_1cm: CloudScore | None = None
    """None where nothing moves, or the truth is not known in metres."""
    moving_measured: float | None = None
    """Share of what moves by the pictures that has a depth; only with a page."""
    nearest: float
    farthest: float
    views: tuple[ViewResult, ...]
    left_out: dict[str, str] = field(default_factory=dict)
    """Cameras without depth, and why."""
    fused_points: int
    cloud_points: int
    mesh_triangles: int
    files: tuple[str, ...]
    seconds_of: dict[str, float]
    """Wall seconds of each stage."""


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
    """Cameras without depth, and why."""
    seconds: float = 0.0
    reason: str = ""


class SequenceResult(Provenance, frozen=True, kw_only=True, omit_defaults=True):
    """The clouds of many instants, and this run; shares are medians over the instants that have them."""

    session: str
    condition: str
    matcher: str
    calibration: str
    unit: str
    instants: tuple[SequenceInstant, ...]
    clouds: int
    kept: int = 0
    """Clouds that an earlier run had made, which was stopped."""
    mover_f_score_1cm: float | None = None
    mover_within_2pct: float | None = None
    within_2pct: float | None = None
    masks: bool = False
    files: tuple[str, ...]
