"""The parts of a comparison that take all cameras at once: depth from many views, and poses."""

from dataclasses import dataclass
from pathlib import Path

import msgspec

from capture_app.errors import NotAvailableError
from reconstruction import wording
from reconstruction.calibration import views_of
from reconstruction.conditions import DISTINCT, SYNCED, Condition
from reconstruction.dataset import Dataset
from reconstruction.multiview_shots import Shots
from reconstruction.multiview_study import MultiviewStudy
from reconstruction.pipeline import Progress, Stages
from reconstruction.pose_study import LARGE_MOVING_SHARE, PoseStudy
from reconstruction.results import MultiviewComparison, PoseComparison
from reconstruction.rig import Rig
from reconstruction.scene_motion import SceneMotion

TOGETHER, APART = Condition(SYNCED), Condition(DISTINCT)


@dataclass(frozen=True, kw_only=True)
class AllCamerasOptions:
    """How much of it is wanted."""

    multiview_instants: int = 3
    """Instants of the burst for depth from all cameras; 0 = none."""
    multiview_width: int = 640
    """Wider pictures are made smaller for that, px."""
    poses: bool | None = None
    """Whether to find poses from single instants; None = where much moves."""


class AllCameras:
    """Depth from all cameras and their poses, in any condition; what cannot be had says why."""

    def __init__(self, rig: Rig, options: AllCamerasOptions) -> None:
        self.rig = rig
        self.options = options
        self.multiview: MultiviewComparison | None = None
        self.poses: PoseComparison | None = None
        self.no_multiview = "it was not asked for"
        self.no_poses = "it was not asked for"
        self._multiview: MultiviewStudy | None = None
        self._poses: PoseStudy | None = None

    def steps(self) -> int:
        """How many progress lines `run` prints at most."""
        instants = min(self.options.multiview_instants, len(self.rig.dataset.instants_ns))
        return (1 + 2 * instants if instants else 0) + (self.options.poses is not False)

    def run(self, middle: int, moving_share: float, progress: Progress, folder: Path) -> None:
        """Synchronized against every camera off by another time; `middle` is an instant amid the burst.

        Pictures go into the folder.
        """
        if self.options.multiview_instants:
            progress.step("which cameras see the same")
            try:
                self._multiview = self._study(self.rig.dataset, self.rig.motion, self.rig.stages, middle)
                self.multiview = self._multiview.compare(APART, progress, folder)
                self.no_multiview = ""
            except ValueError as error:
                self.no_multiview = str(error)
        asked, share = self.options.poses, wording.share(moving_share, decimals=0)
        if asked is None and moving_share < LARGE_MOVING_SHARE:
            self.no_poses = (
                f"what moves fills {share} of the picture; what stands still outweighs it and places the "
                "cameras as well from late pictures (--poses measures it)"
            )
        elif asked is not False:
            why = "asked for" if asked else f"{share} of the picture moves"
            progress.step("where the cameras stand, from single instants")
            try:
                self._poses = self._pose_study(self.rig.dataset, self.rig.stages)
                self.poses = self._poses.compare(APART, why)
                self.no_poses = ""
            except (ValueError, NotAvailableError) as error:
                self.no_poses = str(error)

    def judge(
        self, condition: Condition, progress: Progress
    ) -> tuple[MultiviewComparison | None, PoseComparison | None, list[str]]:
        """A further condition, and what of it cannot be had."""
        if condition == APART:
            return self.multiview, self.poses, []
        many, poses, skipped = None, None, []
        if self._multiview is not None and self.multiview is not None:
            try:
                many = self._multiview.compare(condition, progress)
            except ValueError as error:
                skipped.append(f"depth from all cameras: {error}")
        if self._poses is not None and self.poses is not None:
            try:
                poses = self._poses.compare(condition, self.poses.why)
            except ValueError as error:
                skipped.append(f"poses: {error}")
        return many, poses, skipped

    def judge_session(
        self, other: Dataset, motion: SceneMotion, stages: Stages
    ) -> tuple[MultiviewComparison | None, PoseComparison | None, list[str]]:
        """Another session's pictures of its own instants, beside this session's; not paired."""
        quiet = Progress(0, silent=True)
        many, poses, skipped = None, None, []
        if self.multiview is not None:
            try:
                found = self._study(other, motion, stages, len(other.instants_ns) // 2).compare(
                    TOGETHER, quiet
                )
                if found.reference != self.multiview.reference:
                    raise ValueError(f"{found.reference} is in its middle, not {self.multiview.reference}")
                many = msgspec.structs.replace(
                    found, synced=self.multiview.synced, offset=found.synced, differences={}, per_instant=()
                )
            except ValueError as error:
                skipped.append(f"depth from all cameras: {error}")
        if self.poses is not None:
            try:
                placed = self._pose_study(other, stages).compare(TOGETHER, self.poses.why)
                poses = msgspec.structs.replace(
                    placed, synced=self.poses.synced, offset=placed.synced, differences={}, per_instant=()
                )
            except ValueError as error:
                skipped.append(f"poses: {error}")
        return many, poses, skipped

    def _study(self, dataset: Dataset, motion: SceneMotion, stages: Stages, middle: int) -> MultiviewStudy:
        calibration = dataset.calibration() or self.rig.calibration
        if calibration is None:
            raise ValueError("there is no calibration")
        shots = Shots(dataset, motion, views_of(dataset, calibration), self.options.multiview_width)
        study = MultiviewStudy(shots, stages, calibration.unit, self.options.multiview_instants)
        study.prepare(middle)
        return study

    def _pose_study(self, dataset: Dataset, stages: Stages) -> PoseStudy:
        calibration = dataset.calibration() or self.rig.calibration
        if calibration is None:
            raise ValueError("there is no calibration to hold poses against")
        source = calibration.source or "the session's own"
        return PoseStudy(dataset, views_of(dataset, calibration), stages, source)
