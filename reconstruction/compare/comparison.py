"""`reconstruct compare`: the effect of synchronization on depth, panorama and poses of one burst."""

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.console.terminal import Progress
from reconstruction.bullet_time import render_burst_grid, render_camera_sweep
from reconstruction.calibration.kept import settle_calibration
from reconstruction.calibration.rig import Rig
from reconstruction.common.memory import memory_budget
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.outputs import STAGES, comparison_folder, write_metrics
from reconstruction.compare.multiview_study import MultiviewStudy
from reconstruction.compare.panorama_study import PanoramaStudy
from reconstruction.compare.pose_study import LARGE_MOVING_SHARE, PoseStudy
from reconstruction.compare.stereo_study import StereoStudy
from reconstruction.compare.study import Study
from reconstruction.compare.timing_study import TimingStudy
from reconstruction.compare.tolerance import measure_curve, whole_frame_offsets
from reconstruction.compare.triangulation_study import TriangulationStudy
from reconstruction.multiview.matcher import Matcher, choose_matcher
from reconstruction.report import wording
from reconstruction.report.comparison_report import report_words, write_report
from reconstruction.report.findings import verdict
from reconstruction.scores.comparison_results import CompareResult, ConditionResult, OffsetTolerance
from reconstruction.scores.timing import RigTiming, Timing, with_depth
from reconstruction.session.conditions import (
    DEFAULT_OFFSET_MS,
    Condition,
    FrameOffset,
    evenly_spread,
    nearest_frame_offset,
)
from reconstruction.session.dataset import Dataset
from reconstruction.session.instants import fixed_offsets_ms
from reconstruction.session.picture_checksums import picture_checks

TOLERANCE_INSTANTS = 6
"""Instants of the tolerance curve within a comparison; `reconstruct tolerance` takes more."""


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Options of a comparison; pairs are names of cameras, None = chosen from the images."""

    offset_ms: float = DEFAULT_OFFSET_MS
    stereo: tuple[str, str] | None = None
    panorama: tuple[str, str] | None = None
    max_instants: int = 16
    multiview_instants: int = 3
    """Instants of the burst for depth from all cameras; 0 = none."""
    multiview_width: int = 640
    """Wider images are reduced to this width for depth from all cameras, px."""
    matcher: Matcher = Matcher.AUTO
    """What finds depth from all cameras."""
    poses: bool | None = None
    """Whether to estimate poses from single instants; None = if much of the picture moves."""
    conditions: tuple[Condition, ...] = ()
    """Further conditions beside every study's own."""
    against: Path | None = None
    """Another session to compare with."""
    time_shifts_ms: Mapping[str, float] = field(default_factory=dict)
    """What is added to the times of the cameras it names."""


def compare(session: Path, out: Path, options: CompareOptions) -> CompareResult:
    """Compare a session with itself, one camera offset; write metrics, pictures and the report to `out`.

    The folder appears whole or not at all.

    Raises:
        SimulshotError: the session, the options or the folder cannot be used, or PatchMatch was asked for and
            cannot run here.
    """
    began = time.monotonic()
    dataset = Dataset.open(session, options.time_shifts_ms)
    settle_calibration(dataset)
    offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, options.offset_ms)
    with comparison_folder(out) as output:
        result = Comparison(dataset, offset, options, output.folder).run_studies(session)
        result = msgspec.structs.replace(
            result,
            verdict=verdict(result),
            words=report_words(result),
            report="report.html",
            seconds=time.monotonic() - began,
        )
        write_report(result, output.folder)
        write_metrics(output.folder, result)
    return result


class Comparison:
    """The studies of an opened session, up to a result without its report."""

    def __init__(self, dataset: Dataset, offset: FrameOffset, options: CompareOptions, folder: Path) -> None:
        self.dataset = dataset
        self.offset = offset
        self.options = options
        self.folder = folder
        self.rig = rig = Rig(dataset, folder / STAGES, offset.step)
        self.middle = offset.pairs[len(offset.pairs) // 2][0]
        most = options.max_instants
        for pair in (options.stereo, options.panorama):
            rig.check_pair(pair)
        for condition in options.conditions:
            condition.check(dataset)
        self.against = Dataset.open(options.against) if options.against is not None else None
        matcher = choose_matcher(options.matcher, quick=True)
        self.stereo = StereoStudy(rig, offset, options.stereo, most)
        self.panorama = PanoramaStudy(rig, offset, options.panorama, most)
        self.multiview = MultiviewStudy(
            rig, options.multiview_instants, options.multiview_width, matcher=matcher
        )
        self.triangulation = TriangulationStudy(rig, offset, self.stereo, most)
        self.poses = PoseStudy(rig)
        self.studies: tuple[Study, ...] = (
            self.multiview, self.stereo, self.triangulation, self.panorama, self.poses
        )  # fmt: skip
        asked: list[Study] = [self.stereo, self.triangulation, self.panorama]
        asked += [self.multiview] if options.multiview_instants else []
        asked += [self.poses] if options.poses is not False else []
        steps = sum(study.steps for study in asked)
        further = len(options.conditions) + (self.against is not None)
        self.progress = Progress(5 + steps + (len(dataset.cameras) > 2) + further + 1)
        self.tolerance: OffsetTolerance | None = None
        self.times = TimingStudy(rig)
        self.timing: Timing | None = None
        self.rig_timing: RigTiming | None = None

    def run_studies(self, session: Path) -> CompareResult:
        """Run every study in turn; one that is impossible is skipped with its reason."""
        self.progress.step(f"detecting motion in {self.dataset.name}")
        moving = self.rig.moving_share([k for k, _ in evenly_spread(self.offset.pairs, 4)])
        self.progress.step("calibration")
        no_views: BadInputError | NotAvailableError | None = None
        try:
            self.rig.calibrate()
        except (BadInputError, NotAvailableError) as error:
            no_views = error
        self.progress.step("choosing cameras")
        if no_views is None:
            self._run(self.stereo)
            self._measure_tolerance()
        self._run(self.panorama)
        if no_views is None:
            if self.timing is None and not self.panorama.found.skipped:
                self.timing = self._measure_timing(self.panorama.found.pair)
            if len(self.rig.views) > 2:
                self.progress.step("lateness of all cameras")
                reference = self.timing.reference if self.timing is not None else None
                self.rig_timing = self.times.measure_rig(reference)
            self._run(self.triangulation)
        else:
            if self.panorama.found.skipped and isinstance(no_views, NotAvailableError):
                raise no_views
            self.stereo.skip(str(no_views))
            self.triangulation.skip(str(no_views))
        if self.options.multiview_instants:
            self._run(self.multiview)
        self._run_poses(moving)
        conditions = self._further_conditions()
        self.progress.last("report")
        return CompareResult(
            session=str(session),
            origin=self.dataset.session.manifest.origin,
            camera_count=len(self.dataset.cameras),
            instant_count=len(self.dataset.instants_ns),
            offset_ms=self.offset.asked_ms,
            offset_frames=self.offset.frames,
            actual_offset_ms=self.offset.actual_ms,
            time_shifts_ms=dict(self.options.time_shifts_ms),
            unsynchronized=self.dataset.unsynchronized,
            timing=self.timing,
            rig_timing=self.rig_timing,
            calibration=self.rig.source,
            moving_share=moving,
            studies=tuple(study.found for study in self.studies),
            sync_residual_us=self.dataset.worst_residual_us(),
            sync_bound_us=self.dataset.worst_hard_bound_us(),
            conditions=conditions,
            tolerance=self.tolerance,
            burst=render_burst_grid(self.dataset, self.folder),
            bullet_time=render_camera_sweep(
                self.dataset,
                self.rig.motion,
                self.rig.views,
                self.folder,
                timing=self.timing,
                rig_timing=self.rig_timing,
            ),
            memory_notes=memory_budget().notes,
            changed_pictures=picture_checks().changed,
            versions=library_versions(),
        )

    def _run(self, study: Study) -> None:
        study.run(self.middle, self.progress, self.folder)

    def _measure_tolerance(self) -> None:
        """The stereo pair's depth against offset, over fewer instants."""
        if self.stereo.found.skipped:
            return
        pair = self.stereo.found.pair
        self.timing = with_depth(self._measure_timing(pair), self.stereo.found)
        self.progress.step("depth against offset")
        with suppress(ValueError):
            most = min(TOLERANCE_INSTANTS, self.options.max_instants)
            steps = whole_frame_offsets(self.dataset, max(self.offset.actual_ms, DEFAULT_OFFSET_MS))
            quiet = Progress(0, silent=True)
            self.tolerance = measure_curve(self.rig, pair, steps, most, quiet, self.timing)
            self.timing = self.tolerance.timing

    def _measure_timing(self, pair: tuple[str, str]) -> Timing:
        self.progress.step(f"lateness of {pair[1]} against {pair[0]}")
        return self.times.measure_pair(pair)

    def _run_poses(self, moving: float) -> None:
        """Estimate poses if asked for or if much moves; `moving` is the share of moving pixels."""
        asked, share = self.options.poses, wording.share(moving, decimals=0)
        if asked is None and moving < LARGE_MOVING_SHARE:
            self.poses.skip(
                f"{share} of the picture moves, which pose estimation rejects as outliers, in late pictures "
                "too (--poses measures it anyway)",
                unasked=True,
            )
        elif asked is not False:
            self.poses.reason = "asked for" if asked else f"{share} of the picture moves"
            self._run(self.poses)

    def _further_conditions(self) -> tuple[ConditionResult, ...]:
        """The conditions asked for, and another session, beside every study's own."""
        made = [study for study in self.studies if not study.found.skipped]
        found = []
        for condition in self.options.conditions:
            self.progress.step(f"condition {condition.name}")
            late_ms = fixed_offsets_ms(condition, self.dataset)
            studies = tuple(study.compare_condition(condition) for study in made)
            found.append(ConditionResult(name=condition.name, offsets_ms=late_ms, studies=studies))
        if self.against is not None:
            self.progress.step(f"session {self.against.name}")
            # By its own calibration, else by this one's.
            rig = Rig(self.against, self.folder / STAGES, self.offset.step)
            if calibration := self.against.calibration() or self.rig.calibration:
                rig.use_calibration(calibration)
            studies = tuple(study.compare_session(rig) for study in made)
            session = str(self.against.session.folder)
            found.append(ConditionResult(name=self.against.name, session=session, studies=studies))
        return tuple(found)
