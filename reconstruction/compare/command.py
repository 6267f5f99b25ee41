"""`reconstruct compare`: what synchronization does to depth and to a panorama, on one burst."""

import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from capture_app.errors import NotAvailableError
from capture_app.terminal import Progress
from reconstruction.bullet_time.burst_grid import burst_grid
from reconstruction.bullet_time.camera_sweep import render_camera_sweep
from reconstruction.calibration.rig import Rig
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.output_folder import comparison_folder, write_metrics
from reconstruction.common.stage_cache import StageCache
from reconstruction.compare.all_cameras import AllCameras, AllCamerasOptions
from reconstruction.compare.depth_pictures import depth_pictures
from reconstruction.compare.depth_study import DepthStudy
from reconstruction.compare.dose import measure, offsets
from reconstruction.compare.further import Chosen, judge, judge_session
from reconstruction.compare.panorama_study import PanoramaStudy
from reconstruction.report.report import write_report
from reconstruction.report.verdict import verdict
from reconstruction.scores.compare_results import CompareResult, ConditionResult
from reconstruction.scores.depth_results import StereoComparison
from reconstruction.scores.dose_results import DoseResult
from reconstruction.scores.panorama_results import PanoramaComparison
from reconstruction.scores.results import Picture
from reconstruction.session.conditions import DEFAULT_OFFSET_MS, Condition
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import (
    FrameOffset,
    evenly_spread,
    nearest_frame_offset,
    pairs_with_images,
)
from reconstruction.session.scene_motion import SceneMotion

DOSE_INSTANTS = 6
"""Instants of the dose curve within a comparison; `reconstruct dose` takes more."""


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """What can be asked for; pairs are names of cameras, None = chosen from the images."""

    offset_ms: float = DEFAULT_OFFSET_MS
    stereo: tuple[str, str] | None = None
    stitch: tuple[str, str] | None = None
    most_instants: int = 16
    all_cameras: AllCamerasOptions = field(default_factory=AllCamerasOptions)
    conditions: tuple[Condition, ...] = ()
    """Further ones beside the pair that is `offset_ms` apart."""
    against: Path | None = None
    """Another session as a condition."""


def compare(session: Path, out: Path, options: CompareOptions) -> CompareResult:
    """Compare a session with itself, one camera offset; write metrics, pictures and the report to `out`.

    The folder appears whole or not at all.

    Raises:
        SimulshotError: the session, the options or the folder cannot be used.
    """
    began = time.monotonic()
    dataset = Dataset.open(session)
    offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, options.offset_ms)
    with comparison_folder(out) as output:
        result = _Comparison(dataset, offset, options, output.folder).run(session)
        result = msgspec.structs.replace(result, report="report.html", seconds=time.monotonic() - began)
        write_report(result, output.folder)
        write_metrics(output.folder, result)
    return result


class _Comparison:
    """One run, from an opened session to a result without its report."""

    def __init__(self, dataset: Dataset, offset: FrameOffset, options: CompareOptions, folder: Path) -> None:
        self.dataset = dataset
        self.offset = offset
        self.options = options
        self.folder = folder
        self.stages = StageCache(folder / "stages", dataset.fingerprint())
        self.motion = SceneMotion(dataset, offset.step)
        self.rig = Rig(dataset, self.motion, self.stages)
        self.middle = offset.pairs[len(offset.pairs) // 2][0]
        for pair in (options.stereo, options.stitch):
            self.rig.check_pair(pair)
        self.conditions = options.conditions
        for condition in self.conditions:
            condition.check(dataset)
        self.against = Dataset.open(options.against) if options.against is not None else None
        self.panorama: PanoramaStudy | None = None
        self.all = AllCameras(self.rig, options.all_cameras)
        each = 1 + min(len(offset.pairs), options.most_instants)
        further = len(self.conditions) + (self.against is not None)
        self.progress = Progress(4 + each + each + self.all.steps() + further + 1)
        self.dose: DoseResult | None = None
        self.pictures: list[Picture] = []

    def run(self, session: Path) -> CompareResult:
        """Everything in turn; a half that is impossible is skipped with its reason."""
        self.progress.step(f"what moves in {self.dataset.name}")
        moving = self.rig.moving_share([k for k, _ in evenly_spread(self.offset.pairs, 4)])
        self.progress.step("calibration")
        no_views = self.rig.try_calibrate()
        self.progress.step("choosing cameras")
        stereo, stereo_skipped = self._stereo(no_views)
        stitched, stitch_skipped = self._stitch()
        if stereo is None and stitched is None and isinstance(no_views, NotAvailableError):
            raise no_views
        self.all.run(self.middle, moving, self.progress, self.folder)
        conditions = self._further(stereo, stitched)
        self.progress.last("report")
        return CompareResult(
            session=str(session),
            offset_ms=self.offset.asked_ms,
            offset_frames=self.offset.frames,
            actual_offset_ms=self.offset.actual_ms,
            verdict=verdict(
                stereo, stitched, self.offset.actual_ms, moving, self.all.poses, self.all.multiview
            ),
            calibration=self.rig.source,
            stereo=stereo,
            stitch=stitched,
            multiview=self.all.multiview,
            poses=self.all.poses,
            stereo_skipped=stereo_skipped,
            stitch_skipped=stitch_skipped,
            multiview_skipped=self.all.no_multiview,
            poses_skipped=self.all.no_poses,
            sync_residual_us=self.dataset.worst_residual_us(),
            sync_bound_us=self.dataset.worst_hard_bound_us(),
            pictures=tuple(self.pictures),
            conditions=conditions,
            dose=self.dose,
            burst=burst_grid(self.dataset, self.folder),
            bullet_time=render_camera_sweep(self.dataset, self.motion, self.rig.views, self.folder),
            versions=library_versions(),
        )

    def _further(
        self, stereo: StereoComparison | None, stitched: PanoramaComparison | None
    ) -> tuple[ConditionResult, ...]:
        """What was asked for beside the two conditions."""
        chosen = Chosen(self.rig, self.options.most_instants, stereo, stitched, self.panorama, self.all)
        found = []
        for condition in self.conditions:
            self.progress.step(f"condition {condition.name}")
            found.append(judge(chosen, condition))
        if self.against is not None:
            self.progress.step(f"session {self.against.name}")
            found.append(judge_session(chosen, self.against, self.stages.folder, self.offset.step))
        return tuple(found)

    def _pairs(self, cameras: tuple[str, str]) -> list[tuple[int, int]]:
        found = pairs_with_images(self.dataset, self.offset, *cameras)
        if not found:
            raise ValueError(f"{cameras[0]} and {cameras[1]} have no images of the same instants")
        return evenly_spread(found, self.options.most_instants)

    def _stereo(self, no_views: Exception | None) -> tuple[StereoComparison | None, str]:
        if no_views is not None:
            return None, str(no_views)
        choice = self.rig.choose_stereo_pair(self.options.stereo, self.middle)
        if choice.cameras is None:
            return None, choice.why
        try:
            study = DepthStudy(
                self.dataset,
                self.motion,
                self.rig.views,
                choice.cameras,
                self._pairs(choice.cameras),
                self.rig.unit,
            )
            instants = study.run(self.stages, self.progress)
        except ValueError as error:
            return None, f"{choice.cameras[0]} and {choice.cameras[1]}: {error}"
        self.pictures += depth_pictures(study, instants, self.folder)
        self._dose(choice.cameras)
        return study.result(instants, choice.why), ""

    def _dose(self, cameras: tuple[str, str]) -> None:
        """The same pair's depth against offset, over fewer instants."""
        self.progress.step("depth against offset")
        with suppress(ValueError):
            most = min(DOSE_INSTANTS, self.options.most_instants)
            steps = offsets(self.dataset, max(self.offset.actual_ms, DEFAULT_OFFSET_MS))
            self.dose = measure(self.rig, cameras, steps, most, Progress(0, silent=True))

    def _stitch(self) -> tuple[PanoramaComparison | None, str]:
        choice = self.rig.choose_panorama_pair(self.options.stitch, self.middle)
        if choice.cameras is None:
            return None, choice.why
        try:
            study = PanoramaStudy(
                self.dataset, self.motion, self.rig.views, choice.cameras, self._pairs(choice.cameras)
            )
            self.progress.step(f"registering {choice.cameras[0]} and {choice.cameras[1]}")
            study.register()
            result = study.result(self.progress, choice.why)
        except ValueError as error:
            return None, str(error)
        self.pictures += study.pictures(self.folder)
        self.panorama = study
        return result, ""
