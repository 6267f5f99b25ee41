"""The study of single points that COLMAP finds and triangulates under the rig's poses, in any condition."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.geometry import Array
from reconstruction.common.native_libraries import library_versions
from reconstruction.compare.study import ALL_APART, SIDES, SYNCHRONIZED, ComparisonTally, PairStudy
from reconstruction.scores.depth_truth import right_depth
from reconstruction.scores.results import TriangulationComparison, TriangulationScores
from reconstruction.scores.tally import Measurements, measures_of
from reconstruction.session.conditions import Condition
from reconstruction.session.frame_offset import FrameOffset
from reconstruction.session.instant_choice import choose_moving_instants
from reconstruction.session.mover_detection import dilate
from reconstruction.session.shown_instants import ShownInstant, fullest_instants, relative_offsets_ms
from reconstruction.triangulation.rig_triangulator import RigPoints, RigTriangulator

MAX_CAMERAS = 5
"""More cameras find more points, but say no more about timing."""
MAX_PICTURES = 24
"""Pictures whose features are looked for, about; each takes some tenths of a second."""
INSTANT_LIMITS = (3, 8)
CONTROL_MARGIN_PX = 4
"""Points seen this near to something that moves do not belong to the control."""


@dataclass(frozen=True, eq=False)
class _Masks:
    """Of a camera in a condition: what moves in the picture it shows, and what moves or changes in either."""

    moving: Array
    hidden: Array


class TriangulationStudy:
    """COLMAP's points on what moves and on what stands still, from the same cameras in both conditions."""

    subject = "points by COLMAP"

    def __init__(
        self,
        rig: Rig,
        offset: FrameOffset | None,
        depth: PairStudy,
        max_instants: int,
        cameras: tuple[str, ...] = (),
    ) -> None:
        """`depth`: cameras are chosen around its pair, where it has found one; `cameras` have been chosen."""
        self.rig = rig
        self.dataset = rig.dataset
        self.offset = offset
        self.depth = depth
        self.max_instants = max_instants
        self.cameras = cameras
        self.condition = SYNCHRONIZED

    @property
    def steps(self) -> int:
        """One for choosing the cameras, and one for each instant."""
        return 1 + min(self.max_instants, INSTANT_LIMITS[1], len(self.dataset.instants_ns))

    def for_session(self, rig: Rig) -> Self:
        """The same cameras of another session."""
        return type(self)(rig, None, self.depth, self.max_instants, self.cameras)

    def prepare(self, middle: int, progress: Progress) -> None:
        """As `Study.prepare`.

        Raises:
            ValueError: fewer than two of the cameras are calibrated, or the burst does not hold the offset.
        """
        progress.step("choosing cameras for points by COLMAP")
        self.cameras = self._choose_cameras()
        if self.offset is None:
            return
        late = tuple((camera, self.offset.actual_ms) for camera in self.cameras[1::2])
        second_late = Condition(f"{self.offset.asked_ms:g}ms", named_ms=late)
        self.condition = ALL_APART
        if len(self.cameras) == 2 or not self._holds(ALL_APART):
            self.condition = second_late

    def compare(
        self, condition: Condition, progress: Progress, folder: object = None
    ) -> TriangulationComparison:
        """As `Study.compare`; there are no pictures.

        Raises:
            ValueError: the burst does not hold this condition, or COLMAP finds no point when synchronized.
        """
        instants = self._instants(condition)
        tally = ComparisonTally(TriangulationScores, measures_of(TriangulationScores))
        found = 0
        for one in instants:
            progress.step(f"points by COLMAP from {len(one.shown)} cameras, instant {one.instant}")
            sides = dict(zip(SIDES, (one.together, one.shown), strict=True))
            points = {side: self._points(pictures) for side, pictures in sides.items()}
            found += len(points["synced"].points)
            masks = {side: self._masks(pictures, sides) for side, pictures in sides.items()}
            measured = {side: self._measure(points[side], sides[side], masks[side]) for side in SIDES}
            tally.add(measured, {"instant": one.instant, **one.delays_ms(self.dataset)})
        if not found:
            raise ValueError(f"COLMAP finds no point that two of {', '.join(self.cameras)} see")
        return TriangulationComparison(
            cameras=self.cameras,
            synced=tally.synced,
            offset=tally.offset,
            offsets_ms=relative_offsets_ms(condition, self.dataset, self.cameras[0], self.cameras),
            per_instant=tally.per_instant,
            differences=tally.differences,
            left_out=tuple(c for c in self.rig.views if c not in self.cameras),
        )

    def _choose_cameras(self) -> tuple[str, ...]:
        """The pair for depth and those nearest to it; without one, those nearest to the rig's middle."""
        views = self.rig.views
        if not views:
            raise ValueError("the cameras have no calibration")
        if self.cameras:
            if missing := [c for c in self.cameras if c not in views]:
                raise ValueError(f"no calibration of {', '.join(missing)}")
            return self.cameras
        chosen = [c for c in self.depth.cameras if c in views]
        centres = {c: view.centre for c, view in views.items()}
        middle = np.mean([centres[c] for c in chosen or views], axis=0)
        away = {c: float(np.linalg.norm(centre - middle)) for c, centre in centres.items()}
        chosen += sorted((c for c in views if c not in chosen), key=lambda c: away[c])
        chosen = chosen[:MAX_CAMERAS]
        # Of two the second is late, as in the pair for depth.
        chosen = chosen if len(chosen) == 2 else [c for c in views if c in chosen]
        if len(chosen) < 2:
            raise ValueError("points are placed by two calibrated cameras or more")
        return tuple(chosen)

    def _holds(self, condition: Condition) -> bool:
        try:
            self._instants(condition)
        except ValueError:
            return False
        return True

    def _instants(self, condition: Condition) -> list[ShownInstant]:
        """Of the instants at which most cameras have all their pictures, those at which something moves."""
        fullest = fullest_instants(self.dataset, condition, self.cameras[0], self.cameras, fewest=2)
        wanted = int(np.clip(MAX_PICTURES // (2 * len(fullest[0].shown) - 1), *INSTANT_LIMITS))
        first = list(fullest[0].shown)[:2]
        by_instant = {one.instant: one for one in fullest if one.shown.keys() >= set(first)}
        chosen = choose_moving_instants(
            self.rig.motion, first, list(by_instant), min(self.max_instants, wanted)
        )
        return [by_instant[instant] for instant in chosen]

    @cached_property
    def _triangulator(self) -> RigTriangulator:
        return RigTriangulator(self.dataset, self.rig.views)

    def _points(self, shown: Mapping[str, int]) -> RigPoints:
        views = [repr(self.rig.views[camera]) for camera in shown]
        version = library_versions()["pycolmap"]
        made = self.rig.stages.arrays(
            "triangulation",
            lambda: vars(self._triangulator.triangulate(shown)),
            tuple(shown.items()),
            views,
            version,
        )
        return RigPoints(**made)

    def _masks(self, pictures: Mapping[str, int], sides: Mapping[str, Mapping[str, int]]) -> list[_Masks]:
        motion, masks = self.rig.motion, []
        for camera, instant in pictures.items():
            changing = [motion.changing(camera, shown[camera]) for shown in sides.values()]
            hidden = dilate(np.logical_or.reduce(changing), CONTROL_MARGIN_PX)
            masks.append(_Masks(motion.moving(camera, instant), hidden))
        return masks

    def _measure(self, found: RigPoints, pictures: Mapping[str, int], masks: list[_Masks]) -> Measurements:
        """Points on what moves (in half of their pictures or more) and on the still control."""
        moving, hidden = np.zeros(len(found.point), bool), np.zeros(len(found.point), bool)
        right, known = np.zeros(len(found.point), bool), np.zeros(len(found.point), bool)
        for place, (camera, instant) in enumerate(pictures.items()):
            mine = found.camera == place
            columns, rows = found.pixel[mine].T.clip(0, np.array([self.dataset.size(camera)]).T - 1)
            moving[mine], hidden[mine] = (
                masks[place].moving[rows, columns],
                masks[place].hidden[rows, columns],
            )
            truth = self.dataset.ground_truth(camera, instant) if self.rig.unit == "m" else None
            if truth is not None:
                view = self.rig.views[camera]
                depth = (found.points[found.point[mine]] @ view.rotation.T + view.translation)[:, 2]
                true = truth[0][rows, columns]
                right[mine], known[mine] = right_depth(depth, true), true > 0
        seen = _count(found, np.ones_like(moving))
        on_mover = 2 * _count(found, moving) >= seen
        still = _count(found, hidden) == 0
        judged = _count(found, known) == seen
        correct = 2 * _count(found, right) >= seen
        measured = Measurements()
        anything = any(one.moving.any() for one in masks)
        for kind, mask, there in (("mover", on_mover, anything), ("static", still & ~on_mover, True)):
            measured.means[f"{kind}_points"] = np.array([float(mask.sum())] * there)
            measured.medians[f"{kind}_reprojection_px"] = found.errors[mask]
            measured.shares[f"{kind}_precision"] = (
                int((correct & judged & mask).sum()),
                int((judged & mask).sum()),
            )
        return measured


def _count(found: RigPoints, which: Array) -> Array:
    """How many of each point's observations are among these (bool)."""
    return np.bincount(found.point[which], minlength=len(found.points))
