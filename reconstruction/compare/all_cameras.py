"""The parts of a comparison that take all cameras at once: depth from many views, and poses."""

from dataclasses import dataclass
from pathlib import Path

import msgspec

from capture_app.errors import NotAvailableError
from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.compare.multiview_study import MultiviewStudy
from reconstruction.compare.pose_study import LARGE_MOVING_SHARE, PoseStudy
from reconstruction.multiview.undistorted_session import UndistortedSession
from reconstruction.report import wording
from reconstruction.scores.depth_results import MultiviewComparison
from reconstruction.scores.pose_results import PoseComparison
from reconstruction.session.conditions import DISTINCT, SYNCED, Condition

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
                self._multiview = self._study(self.rig, middle)
                self.multiview = self._multiview.compare(APART, progress, folder)
                self.no_multiview = ""
            except ValueError as error:
                self.no_multiview = str(error)
        asked, share = self.options.poses, wording.share(moving_share, decimals=0)
        if asked is None and moving_share < LARGE_MOVING_SHARE:
            self.no_poses = (
                f"what moves fills {share} of the picture: finding poses throws it out with the outliers and "
                "keeps what stands still, also from late pictures (--poses measures it)"
            )
        elif asked is not False:
            why = "asked for" if asked else f"{share} of the picture moves"
            progress.step("where the cameras stand, from single instants")
            try:
                self._poses = _poses_of(self.rig)
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
        self, theirs: Rig
    ) -> tuple[MultiviewComparison | None, PoseComparison | None, list[str]]:
        """Another session's pictures of its own instants, beside this session's; not paired."""
        many, poses, skipped = None, None, []
        if self.multiview is not None:
            try:
                study = self._study(theirs, len(theirs.dataset.instants_ns) // 2)
                found = study.compare(TOGETHER, Progress(0, silent=True))
                if found.reference != self.multiview.reference:
                    raise ValueError(f"{found.reference} is in its middle, not {self.multiview.reference}")
                many = msgspec.structs.replace(
                    found, synced=self.multiview.synced, offset=found.synced, differences={}, per_instant=()
                )
            except ValueError as error:
                skipped.append(f"depth from all cameras: {error}")
        if self.poses is not None:
            try:
                placed = _poses_of(theirs).compare(TOGETHER, self.poses.why)
                poses = msgspec.structs.replace(
                    placed, synced=self.poses.synced, offset=placed.synced, differences={}, per_instant=()
                )
            except ValueError as error:
                skipped.append(f"poses: {error}")
        return many, poses, skipped

    def _study(self, rig: Rig, middle: int) -> MultiviewStudy:
        if not rig.views:
            raise ValueError("the cameras have no calibration")
        shots = UndistortedSession(rig.dataset, rig.motion, rig.views, self.options.multiview_width)
        study = MultiviewStudy(shots, rig.stages, rig.unit, self.options.multiview_instants)
        study.prepare(middle)
        return study


def _poses_of(rig: Rig) -> PoseStudy:
    if not rig.views:
        raise ValueError("the cameras have no calibration that poses could be held against")
    return PoseStudy(rig.dataset, rig.views, rig.stages, rig.source)
