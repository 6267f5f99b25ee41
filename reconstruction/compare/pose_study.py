"""The pose study of a comparison: camera poses estimated from the pictures of single instants."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Self

import numpy as np

from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.geometry import View
from reconstruction.common.native_libraries import library_versions
from reconstruction.compare.study import ALL_APART, SIDES, ComparisonTally
from reconstruction.poses.pose_finder import PoseFinder, relative_pose_errors
from reconstruction.scores.results import PoseComparison, PoseScores
from reconstruction.scores.tally import Measurements, measures_of
from reconstruction.session.conditions import Condition
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread
from reconstruction.session.shown_instants import ShownInstant, fullest_instants, relative_offsets_ms

TOLERANCE_DEG = 2.0
HARMED = 0.1
LARGE_MOVING_SHARE = 0.2
"""If less of the picture moves, pose estimation rejects it as outliers, in late pictures too."""
MAX_INSTANTS = 5


@dataclass(frozen=True)
class InstantPoses:
    """Poses of one instant: how many cameras were placed, and both errors (degrees) of each pair of them."""

    cameras: int
    registered: int
    errors: tuple[tuple[float, float], ...]

    def measure(self) -> Measurements:
        """The measures of the instant."""
        pairs = self.cameras * (self.cameras - 1) // 2
        right = sum(max(error) <= TOLERANCE_DEG for error in self.errors)
        errors = np.array(self.errors, float).reshape(-1, 2)
        return Measurements(
            medians={"rotation_deg": errors[:, 0], "direction_deg": errors[:, 1]},
            means={
                "registered": np.array([float(self.registered)]),
                "correct_pairs": np.array([right / pairs]),
            },
        )


class PoseStudy:
    """Camera poses of single instants, compared with the calibration."""

    subject = "poses"
    condition = ALL_APART
    steps = 1

    def __init__(
        self,
        rig: Rig,
        reason: str,
        max_instants: int = MAX_INSTANTS,
        finder: Callable[[Dataset, Mapping[str, View], Path], PoseFinder] = PoseFinder,
    ) -> None:
        """`reason` says why poses are estimated; `finder` estimates them."""
        self.rig = rig
        self.dataset = rig.dataset
        self.reason = reason
        self.max_instants = max_instants
        self.finder = finder
        self.cameras: tuple[str, ...] = ()

    def for_session(self, rig: Rig) -> Self:
        """Poses of another session's cameras."""
        return type(self)(rig, self.reason, self.max_instants, self.finder)

    def prepare(self, middle: int, progress: Progress) -> None:
        """Refuse cameras whose poses cannot be compared.

        Raises:
            ValueError: fewer than three cameras are calibrated.
        """
        progress.step("camera poses from single instants")
        self.cameras = tuple(name for name in self.dataset.cameras if name in self.rig.views)
        if not self.cameras:
            raise ValueError("the cameras have no calibration to compare poses with")
        if len(self.cameras) < 3:
            raise ValueError("poses of fewer than three cameras cannot be judged: the scale is unknown")

    def compare(self, condition: Condition, progress: Progress, folder: Path | None = None) -> PoseComparison:
        """As `Study.compare`; there are no pictures."""
        instants = self._instants(condition)
        tally = ComparisonTally(PoseScores, measures_of(PoseScores))
        with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
            finder = cache(lambda: self.finder(self.dataset, self.rig.views, Path(scratch)))
            for one in instants:
                sides = zip(SIDES, (one.together, one.shown), strict=True)
                measured = {side: self._poses(finder, pictures).measure() for side, pictures in sides}
                tally.add(measured, {"instant": one.instant})
        synced, offset = tally.synced, tally.offset
        return PoseComparison(
            cameras=self.cameras,
            synced=synced,
            offset=offset,
            degraded=synced.correct_pairs - offset.correct_pairs > HARMED,
            tolerance_deg=TOLERANCE_DEG,
            truth_source=self.rig.source,
            offsets_ms=relative_offsets_ms(condition, self.dataset, self.cameras[0], self.cameras),
            per_instant=tally.per_instant,
            differences=tally.differences,
            reason=self.reason,
        )

    def _instants(self, condition: Condition) -> list[ShownInstant]:
        """The instants at which every camera has its pictures, thinned."""
        cameras = self.cameras
        found = fullest_instants(self.dataset, condition, cameras[0], cameras, fewest=len(cameras))
        return evenly_spread(found, self.max_instants)

    def _poses(self, finder: Callable[[], PoseFinder], shown: dict[str, int]) -> InstantPoses:
        views = self.rig.views

        def make() -> InstantPoses:
            poses = finder().find_poses(shown)
            true = {name: (view.rotation, view.translation) for name, view in views.items()}
            return InstantPoses(len(shown), len(poses), tuple(relative_pose_errors(poses, true)))

        version = library_versions()["pycolmap"]
        return self.rig.stages.record("poses", InstantPoses, make, tuple(shown.items()), repr(views), version)
