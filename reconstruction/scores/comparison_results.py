"""What `reconstruct compare` and `reconstruct tolerance` found: the contents of `metrics.json`."""

from collections.abc import Iterable
from typing import Any

from msgspec import Struct

from reconstruction.common.outputs import Provenance
from reconstruction.scores.study_result import StudyResult
from reconstruction.scores.timing import RigTiming, Timing, are_apart, are_together


class DelayFacts(Struct, frozen=True, kw_only=True):
    """The delay of one point of a curve."""

    offset_frames: int


class InstantTolerance(Struct, frozen=True, kw_only=True):
    """One instant's own depth against offset."""

    instant: int
    mover_pixels: int
    values: tuple[float | None, ...]
    """The curve's measure at each of its points; None where the burst does not reach."""
    peak_ms: float | None = None
    """The offset of the highest of them; None where none stands out."""


class OffsetTolerance(Provenance, frozen=True, kw_only=True):
    """A pair's depth against offset to both sides, by the same calibration throughout."""

    cameras: tuple[str, str]
    measure: str
    """What the curve shows: mover_within_2pct where truth is known, else mover_coverage."""
    points: tuple[StudyResult[DelayFacts], ...]
    """Depth at each offset, from the earliest to the latest; at zero, both conditions are the same."""
    instants: int
    decreasing: bool
    """To either side of zero no point's interval lies wholly above that of the one before it."""
    timing: Timing | None = None
    peak_ms: float | None = None
    """Where the curve is highest: the median of the instants' own peaks."""
    per_instant: tuple[InstantTolerance, ...] = ()
    tolerable_offset_ms: float | None = None
    """The offset at which the curve has lost a tenth (linear between its points), or at which half of what
    moves has moved by one pixel, whichever comes first; None also where the pair is not synchronized."""
    speed_px_per_ms: float | None = None
    """How fast what moves does so in the first camera's picture, the median over its pixels."""
    sync_residual_us: float | None = None
    """The session's own largest error of an image's time by its record."""
    sync_residual_px: float | None = None
    """By how much what moves does so in that time."""
    reason: str = ""
    verdict: str = ""
    """The result in words; empty where it is a part of a comparison, whose page tells it."""
    session: str = ""
    calibration: str = ""
    report: str = ""

    @property
    def as_recorded(self) -> StudyResult[DelayFacts]:
        """The depth at offset zero."""
        return next(point for point in self.points if not point.late_ms)


class ConditionResult(Struct, frozen=True, kw_only=True):
    """A further condition beside the synchronized one, on the same cameras.

    In its studies `synced` is the comparison's own session and `offset` this condition; what the comparison
    itself skipped is not among them.
    """

    name: str
    offsets_ms: dict[str, float] = {}
    """How late each camera is; empty for another session."""
    session: str = ""
    """The other session that this condition is; it is not paired by instant."""
    studies: tuple[StudyResult[Any], ...] = ()


class WordTable(Struct, frozen=True, kw_only=True):
    """A table of the report as it reads there, for a screen."""

    caption: str
    groups: tuple[str, ...]
    """What each column of values is of: moving things or the control; empty where it is of all."""
    columns: tuple[str, ...]
    """Each column's condition."""
    rows: tuple[tuple[str, ...], ...]
    """The measure's name, and a value with its unit for each column."""


class ReportWords(Struct, frozen=True, kw_only=True):
    """What the report calls the conditions, and its tables in words."""

    synced: str
    """Synchronized, or As recorded where the pictures cannot be of one instant."""
    offset: str
    """Such as 67 ms late."""
    unsynchronized: str
    """The other condition where all cameras take part."""
    tables: tuple[WordTable, ...]


class CompareResult(Provenance, frozen=True, kw_only=True):
    """Everything `reconstruct compare` found; written as `metrics.json` and printed by --json."""

    session: str
    origin: str = ""
    """captured, simulated or imported, as the session says."""
    camera_count: int = 0
    instant_count: int = 0
    offset_ms: float
    """The offset that was asked for."""
    offset_frames: int
    actual_offset_ms: float
    unsynchronized: str = ""
    """Why nothing is called synchronized: the offsets between the cameras' times are unknown."""
    verdict: str = ""
    """One or two plain sentences for somebody who has never heard of synchronization."""
    calibration: str
    """Where the calibration came from."""
    moving_share: float = 0.0
    """The share of the pictures that moves, 0..1."""
    studies: tuple[StudyResult[Any], ...] = ()
    """Those of all plugins, in the order of `StudyReport.place`."""
    sync_residual_us: float | None = None
    """Largest distance of an image from its instant, by the session's own record."""
    sync_bound_us: float | None = None
    conditions: tuple[ConditionResult, ...] = ()
    tolerance: OffsetTolerance | None = None
    timing: Timing | None = None
    """How late the depth pair's second camera is, by what moves; None where that was not measured."""
    rig_timing: RigTiming | None = None
    """How late all cameras are, where there are more than two."""
    words: ReportWords | None = None
    report: str = ""

    def together(self, cameras: Iterable[str]) -> bool:
        """As `are_together`."""
        return are_together(cameras, self.timing, self.rig_timing)

    def apart(self, cameras: Iterable[str]) -> bool:
        """As `are_apart`."""
        return are_apart(cameras, self.timing, self.rig_timing)

    def study(self, name: str) -> StudyResult[Any] | None:
        """What a study measured; None where it was skipped."""
        return next((one for one in self.studies if one.name == name and not one.skipped), None)
