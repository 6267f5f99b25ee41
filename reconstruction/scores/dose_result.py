"""What a dose curve found, as `metrics.json` holds it."""

from msgspec import Struct

from reconstruction.scores.results import DepthScores
from reconstruction.scores.timing import Timing


class DosePoint(Struct, frozen=True, kw_only=True):
    """Depth with the second camera so much later, or earlier (negative); medians over the instants."""

    offset_ms: float
    offset_frames: int
    scores: DepthScores


class DoseInstant(Struct, frozen=True, kw_only=True):
    """One instant's own curve."""

    instant: int
    mover_pixels: int
    values: tuple[float | None, ...]
    """The curve's measure at each of its points; None where the burst does not reach."""
    peak_ms: float | None = None
    """The offset of the highest of them; None where none stands out."""


class DoseResult(Struct, frozen=True, kw_only=True):
    """A pair's depth against offset to both sides, by the same calibration throughout."""

    reference: str
    other: str
    measure: str
    """What the curve shows: mover_within_2pct where truth is known, else mover_coverage."""
    points: tuple[DosePoint, ...]
    """From the earliest to the latest."""
    instants: int
    decreasing: bool
    """To either side of zero no point's interval lies wholly above that of the one before it."""
    timing: Timing | None = None
    peak_ms: float | None = None
    """Where the curve is highest: the median of the instants' own peaks."""
    per_instant: tuple[DoseInstant, ...] = ()
    tolerable_offset_ms: float | None = None
    """The offset at which the curve has lost a tenth (linear between its points), or at which half of what
    moves has moved by one pixel, whichever comes first; None also where the pair is not synchronized."""
    speed_px_per_ms: float | None = None
    """How fast what moves does so in the reference's picture, the median over its pixels."""
    sync_residual_us: float | None = None
    """The session's own largest error of an image's time by its record."""
    sync_residual_px: float | None = None
    """By how much what moves does so in that time."""
    reason: str = ""
    session: str = ""
    time_shifts_ms: dict[str, float] = {}
    """What was added to the times of these cameras."""
    calibration: str = ""
    report: str = ""
    seconds: float = 0.0
    memory_notes: tuple[str, ...] = ()
    """What the memory budget changed."""
    changed_pictures: tuple[str, ...] = ()
    """Files whose bytes are not those that were saved."""
    versions: dict[str, str] = {}

    @property
    def as_recorded(self) -> DepthScores:
        """The scores at offset zero."""
        return next(point.scores for point in self.points if point.offset_frames == 0)
