"""Everything that `reconstruct compare` found: the contents of `metrics.json`."""

from msgspec import Struct

from reconstruction.scores.dose_result import DoseResult
from reconstruction.scores.results import (
    MultiviewComparison,
    PanoramaComparison,
    PoseComparison,
    StereoComparison,
    TriangulationComparison,
)
from reconstruction.scores.timing import RigTiming, Timing


class BurstGrid(Struct, frozen=True, kw_only=True):
    """Small pictures of the burst: a row for each camera, a column for each instant; "" = no image."""

    cameras: tuple[str, ...]
    instants: tuple[int, ...]
    times_ms: tuple[float, ...]
    """Since the burst's first instant."""
    thumbnails: tuple[tuple[str, ...], ...]


class BulletTime(Struct, frozen=True, kw_only=True):
    """One instant from camera to camera, synchronized and with cameras late: paths of pictures by camera."""

    cameras: tuple[str, ...]
    """In the order of the sweep."""
    instant: int
    synced: tuple[str, ...]
    offset: tuple[str, ...]
    offsets_ms: tuple[float, ...]
    """How late each camera's offset picture is."""
    stabilized: bool
    """The pictures are turned and zoomed so that what moves stays where it is."""
    ordered_by_position: bool
    """The order is that of the cameras' places, not of their names."""
    file: str
    """An animation of both side by side."""
    synced_step_px: float | None = None
    """How far the largest thing that moves goes from one picture to the next at most, px of the pictures;
    None where they are not stabilized."""
    offset_step_px: float | None = None


class ConditionResult(Struct, frozen=True, kw_only=True):
    """A further condition beside the synchronized one, on the same pairs of cameras.

    In `stereo` and `stitch`, `synced` is the comparison's own session and `offset` this condition.
    """

    name: str
    offsets_ms: dict[str, float] = {}
    """How late each camera is; empty for another session."""
    session: str = ""
    """The other session that this condition is; it is not paired by instant."""
    stereo: StereoComparison | None = None
    stitch: PanoramaComparison | None = None
    multiview: MultiviewComparison | None = None
    triangulation: TriangulationComparison | None = None
    poses: PoseComparison | None = None
    skipped: tuple[str, ...] = ()


class WordTable(Struct, frozen=True, kw_only=True):
    """A table of the report as it reads there, for a screen."""

    caption: str
    groups: tuple[str, ...]
    """Of each column of values: what it is of, moving things or the control; empty where it is of all."""
    columns: tuple[str, ...]
    """Of each column of values: the condition."""
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


class CompareResult(Struct, frozen=True, kw_only=True):
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
    time_shifts_ms: dict[str, float] = {}
    """What was added to the times of these cameras."""
    unsynchronized: str = ""
    """Why nothing is called synchronized: the offsets between the cameras' times are unknown."""
    verdict: str
    """One or two plain sentences for somebody who has never heard of synchronization."""
    calibration: str
    """Where the calibration came from."""
    stereo: StereoComparison | None = None
    stitch: PanoramaComparison | None = None
    multiview: MultiviewComparison | None = None
    triangulation: TriangulationComparison | None = None
    poses: PoseComparison | None = None
    stereo_skipped: str = ""
    stitch_skipped: str = ""
    multiview_skipped: str = ""
    triangulation_skipped: str = ""
    poses_skipped: str = ""
    sync_residual_us: float | None = None
    """Largest distance of an image from its instant, by the session's own record."""
    sync_bound_us: float | None = None
    conditions: tuple[ConditionResult, ...] = ()
    dose: DoseResult | None = None
    timing: Timing | None = None
    """How late the depth pair's second camera is, by what moves; None where that was not measured."""
    rig_timing: RigTiming | None = None
    """The same of all cameras, where there are more than two."""
    burst: BurstGrid | None = None
    bullet_time: BulletTime | None = None
    words: ReportWords | None = None
    report: str = ""
    seconds: float = 0.0
    memory_notes: tuple[str, ...] = ()
    """What the memory budget changed."""
    changed_pictures: tuple[str, ...] = ()
    """Files whose bytes are not those that were saved."""
    versions: dict[str, str] = {}
