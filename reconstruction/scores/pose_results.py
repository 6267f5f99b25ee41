"""Camera poses in a comparison, as `metrics.json` holds them."""

from msgspec import Struct

from reconstruction.scores.results import Interval


class PoseScores(Struct, frozen=True, kw_only=True):
    """Where the cameras stand, found from the pictures of single instants alone, in one condition.

    A pair is placed right where both cameras were placed, and the rotation between them and the direction
    from one to the other are within `PoseComparison.tolerance_deg` of the true ones.
    """

    registered: float
    """Cameras that were placed at an instant; the mean over the instants."""
    correct_pairs: float
    """Share of all pairs of cameras that were placed right."""
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
