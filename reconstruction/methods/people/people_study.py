"""Joints of people in synchronized and in delayed images: reprojection, bones, and the distance of both."""

from typing import Any

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.method.score import UNASKED, Score
from reconstruction.method.study_result import StudyResult
from reconstruction.method.tally import CONDITIONS, Measurements
from reconstruction.method.words import read_words
from reconstruction.methods.people.people_method import PeopleMethod
from reconstruction.methods.people.people_scene import PeopleInstant
from reconstruction.scene.conditions import Condition
from reconstruction.scene.instant_choice import ShownInstant


class PeopleStudy(Score):
    """People in 3D in both conditions, by the same joints in images: only their times differ."""

    text = read_words(__package__)
    needs_calibration = True
    min_cameras = 2
    Options = PeopleMethod

    @property
    def steps(self) -> int:
        """Maximum number of progress lines: one for each camera in which people are searched for."""
        return 0 if self.unasked() or self.options.keypoints else len(self.dataset.cameras)

    def unasked(self) -> str:
        """Return a reason unless people are asked for, as a detector takes a while; see `Score.unasked`."""
        asked = self.options.people or self.options.keypoints or self.text.name in self.context.studies
        return "" if asked else f"{UNASKED} (--people makes it)"

    def prepare(self) -> None:
        """Choose all calibrated cameras."""
        self.cameras = tuple(name for name in self.dataset.cameras if name in self.scene.views)

    def compare(self, condition: Condition, folder: Any = None) -> StudyResult[Any]:
        """Compare a condition; see `Score.compare`."""
        self._synced = dict[int, PeopleInstant]()
        return super().compare(condition, folder)

    def measure_instant(self, result: PeopleInstant, one: ShownInstant, side: str) -> Measurements:
        """Measure one instant: reprojection, cameras that agree, bones, and the motion of joints."""
        if side == CONDITIONS[0]:
            self._synced[result.instant] = result
        synced = self._synced[result.instant]
        joints, synced_joints = result.joints, synced.joints
        known = np.isfinite(joints.error)
        measured = Measurements(
            shares={"agreeing": (int(joints.cameras[known].sum()), int(known.sum()) * len(self.cameras))},
            medians={"reprojection_px": joints.residual_px[known]},
        )
        if known.shape == synced_joints.error.shape:
            apart = np.linalg.norm(joints.positions - synced_joints.positions, axis=2)
            measured.medians["moved"] = apart[np.isfinite(apart)]
            changed = np.abs(_bones(result) / _bones(synced) - 1)
            measured.medians["bones"] = changed[np.isfinite(changed)]
        return measured


def _bones(result: PeopleInstant) -> Array:
    """Return the lengths (people, bones)."""
    places = result.joints.positions
    a, b = np.array(result.skeleton.bones, int).reshape(-1, 2).T
    return np.asarray(np.linalg.norm(places[:, a] - places[:, b], axis=2))
