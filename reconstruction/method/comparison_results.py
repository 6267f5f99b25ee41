"""Results of `reconstruct compare` and `reconstruct tolerance`: the contents of `metrics.json`."""

from collections.abc import Iterable
from typing import Any

from msgspec import Struct

from capture_app.session.format.calibration import LensKnowledge
from reconstruction.method.study_result import StudyResult
from reconstruction.method.timing import SessionTiming, Timing
from reconstruction.scene.provenance import Provenance


class InstantTolerance(Struct, frozen=True, kw_only=True):
    """Depth against offset at one instant."""

    instant: int
    mover_pixels: int
    values: tuple[float | None, ...]
    """The curve's measure at each of its points; None where the burst has no frame at that offset."""
    peak_ms: float | None = None
    """Offset of the largest value; None if there is no clear maximum."""


class OffsetTolerance(Provenance, frozen=True, kw_only=True):
    """Depth of a pair against offset in both directions, with one calibration for all points."""

    cameras: tuple[str, str]
    measure: str
    """The measure that the curve shows: mover_within_2pct if the truth is known, else mover_coverage."""
    points: tuple[StudyResult[dict[str, int]], ...]
    """Depth at each offset, from the earliest to the latest; both conditions are equal at zero.

    The facts of a point are its `offset_frames`: the delay of the late images, in frames.
    """
    instants: int
    decreasing: bool
    """Whether, away from zero, no point's interval is entirely above the interval of the point before it."""
    timing: Timing | None = None
    peak_ms: float | None = None
    """Offset of the curve's maximum: the median of the instants' own peaks."""
    per_instant: tuple[InstantTolerance, ...] = ()
    tolerable_offset_ms: float | None = None
    """Offset at which the curve has lost a tenth, or half of the moving pixels have moved by one pixel.

    The smaller of the two counts; the curve is linear between its points. None also if the pair is not
    synchronized.
    """
    speed_px_per_ms: float | None = None
    """Speed of moving objects in the first camera's image, the median over their pixels."""
    sync_residual_us: float | None = None
    """Largest time error of an image, as the session recorded it."""
    sync_residual_px: float | None = None
    """Motion of moving objects in the image during that time."""
    reason: str = ""
    verdict: str = ""
    """The result in words; empty inside a comparison, whose page states it."""
    session: str = ""
    calibration: str = ""
    lenses: LensKnowledge = LensKnowledge()
    report: str = ""

    @property
    def right(self) -> bool:
        """Whether the curve shows correct depth; false: any depth, as the true one is unknown."""
        return self.measure == "mover_within_2pct"

    @property
    def as_recorded(self) -> StudyResult[dict[str, int]]:
        """Result of the study at offset zero, that is, with the images as recorded."""
        return next(point for point in self.points if not point.late_ms)


class ConditionResult(Struct, frozen=True, kw_only=True):
    """A further condition besides the synchronized one, on the same cameras.

    In its studies `synced` is the comparison's own session and `offset` is this condition. Studies that the
    comparison skipped are left out.
    """

    name: str
    offsets_ms: dict[str, float] = {}
    """Delay of each camera; empty for another session."""
    session: str = ""
    """Path of the other session, if this condition is one; it is not paired by instant."""
    studies: tuple[StudyResult[Any], ...] = ()


class CompareResult(Provenance, frozen=True, kw_only=True):
    """All results of `reconstruct compare`; written to `metrics.json` and printed by --json."""

    session: str = ""
    origin: str = ""
    """Origin of the images as the session records it: captured, simulated or imported."""
    camera_count: int = 0
    instant_count: int = 0
    offset_ms: float = 0.0
    """The requested offset."""
    offset_frames: int = 0
    actual_offset_ms: float = 0.0
    unsynchronized: str = ""
    """Why no condition is called synchronized: the time offsets between the cameras are unknown."""
    staggered: str = ""
    """Planned steps of a staggered session, whose images are not of one instant; empty for any other."""
    verdict: str = ""
    """One or two plain sentences for a reader who does not know what synchronization is."""
    calibration: str = "none"
    """Source of the calibration."""
    lenses: LensKnowledge = LensKnowledge()
    rest_error_px: float | None = None
    """Misfit of points at rest to the calibration, a standard deviation; None if they are too few."""
    rest_points: int = 0
    moving_share: float = 0.0
    """Fraction of the pixels that moves, 0..1."""
    studies: tuple[StudyResult[Any], ...] = ()
    """Results of all study plugins, in the order of `StudyReport.place`."""
    sync_residual_us: float | None = None
    """Largest time between an image and its instant, as the session recorded it."""
    sync_bound_us: float | None = None
    imported_error: tuple[float, str] | None = None
    """Error (95 %) of the times of an imported session, us, and its source: "by sound"."""
    conditions: tuple[ConditionResult, ...] = ()
    tolerance: OffsetTolerance | None = None
    timing: Timing | None = None
    """Time offset of the depth pair's second camera, measured by motion; None if it was not measured."""
    rig_timing: SessionTiming | None = None
    """Time offsets of all cameras, if there are more than two."""
    words: dict[str, Any] | None = None
    """The report's names for the conditions, and its tables in words; see `report_words`."""
    report: str = ""

    @property
    def cameras_moved(self) -> bool:
        """Whether a camera of the depth pair moved while it recorded, so that nothing is a control."""
        return self.timing is not None and bool(self.timing.moving_cameras)

    def together(self, cameras: Iterable[str]) -> bool:
        """Return whether all these cameras were found to show one instant.

        The judgement of the pair decides for these two cameras. If negative, it also decides for any group
        that contains both.
        """
        asked, pair = frozenset(cameras), self.timing
        measured = frozenset(pair.cameras if pair is not None else ())
        if pair is not None and (asked <= measured or (measured <= asked and not pair.synchronized)):
            return pair.synchronized
        return self.rig_timing is not None and asked <= self.rig_timing.together

    def apart(self, cameras: Iterable[str]) -> bool:
        """Return whether any of these cameras was found to show a different instant from another of them."""
        asked = frozenset(cameras)
        measured = (self.timing, *(self.rig_timing.cameras if self.rig_timing is not None else ()))
        return any(
            timing is not None and timing.offset and asked.issuperset(timing.cameras) for timing in measured
        )

    def study(self, name: str) -> StudyResult[Any] | None:
        """Return the result of a study; None if it was skipped."""
        return next((study for study in self.studies if study.name == name and not study.skipped), None)
