"""The stereo half of a comparison: one pair, every usable instant, both conditions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_app.terminal import Progress
from reconstruction.common.geometry import Array, View
from reconstruction.common.stage_cache import StageCache
from reconstruction.scores.depth_results import DepthScores, StereoComparison
from reconstruction.scores.depth_truth import true_depth_in_unit
from reconstruction.scores.still_control import median_still_depth, project_into_other, still_pixels
from reconstruction.scores.tally import Measurements, Tally, differences, measure_depth
from reconstruction.session.dataset import Dataset
from reconstruction.session.scene_motion import SceneMotion
from reconstruction.stereo.disparity_range import find_disparity_range
from reconstruction.stereo.epipolar_error import epipolar_errors
from reconstruction.stereo.stereo_pair import DepthMap, StereoPair

CONDITIONS = ("synced", "offset")
RANGE_INSTANTS = 8
ROW = ("mover_coverage", "static_coverage", "mover_within_2pct", "mover_epipolar_px")
"""What is told of every single instant."""


@dataclass(frozen=True)
class Instant:
    """One instant's depth in both conditions, and the pixels to judge it on (bool, reference view)."""

    now: int
    later: int
    maps: dict[str, DepthMap]
    moving: Array
    static: Array
    truth: Array | None


class DepthStudy:
    """Depth of a pair, synchronized and offset, with all that is fixed for both taken from synced images."""

    def __init__(
        self,
        dataset: Dataset,
        motion: SceneMotion,
        views: dict[str, View],
        cameras: tuple[str, str],
        pairs: Sequence[tuple[int, int]],
        unit: str,
    ) -> None:
        """`pairs` are (instant, later instant); `unit` is the calibration's unit of length."""
        self.dataset = dataset
        self.motion = motion
        self.views = views
        self.reference, self.other = cameras
        self.pairs = list(pairs)
        self.unit = unit
        self.pair: StereoPair | None = None

    def run(self, stages: StageCache, progress: Progress) -> list[Instant]:
        """Depth maps of all instants, from the stages' folder where they are there already.

        Raises:
            ValueError: the pair sees too little in common.
        """
        views = self.views[self.reference], self.views[self.other]
        key = (self.reference, self.other, tuple(now for now, _ in self.pairs), repr(views))
        progress.step(f"depth range of {self.reference} and {self.other}")
        disparities = stages.record("disparities", tuple[float, float], self._disparities, *key)
        self.pair = StereoPair(*views, disparities)
        found = []
        for now, later in self.pairs:
            progress.step(f"stereo {self.reference}-{self.other}, instant {now}")
            maps = {}
            for condition, instant in (("synced", now), ("offset", later)):
                made = stages.arrays(
                    "depth",
                    lambda now=now, instant=instant: vars(  # type: ignore[misc]
                        self._depth(now, instant)
                    ),
                    self.reference,
                    self.other,
                    repr(views),
                    disparities,
                    now,
                    instant,
                )
                maps[condition] = DepthMap(**made)
            found.append((now, later, maps))
        return self._judged(found)

    def _disparities(self) -> tuple[float, float]:
        chosen = self.pairs[:: max(1, len(self.pairs) // RANGE_INSTANTS)]
        images = [
            (
                self.dataset.grey(self.reference, now),
                self.dataset.grey(self.other, now),
                self.motion.detected_movers(self.reference, now),
            )
            for now, _ in chosen
        ]
        return find_disparity_range((self.views[self.reference], self.views[self.other]), images)

    def _depth(self, now: int, instant: int) -> DepthMap:
        assert self.pair is not None
        return self.pair.depth(self.dataset.grey(self.reference, now), self.dataset.grey(self.other, instant))

    def _judged(self, found: list[tuple[int, int, dict[str, DepthMap]]]) -> list[Instant]:
        depths = [maps["synced"].depth for _, _, maps in found]
        moving = [self.motion.moving(self.reference, now) for now, _, _ in found]
        still = median_still_depth(depths, moving)
        where, inside = project_into_other(self.views[self.reference], self.views[self.other], still)
        instants = []
        for (now, later, maps), mask in zip(found, moving, strict=True):
            times = {now, later}
            static = still_pixels(
                where,
                inside,
                [
                    self.motion.changing(self.reference, k)
                    for k in times
                    if self.dataset.has_image(self.reference, k)
                ],
                [self.motion.changing(self.other, k) for k in times],
            )
            truth = self._truth(now, still, static)
            instants.append(Instant(now, later, maps, mask & inside, static, truth))
        return instants

    def _truth(self, instant: int, still: Array, static: Array) -> Array | None:
        """True depth in the calibration's unit, NaN where there is none."""
        loaded = self.dataset.ground_truth(self.reference, instant)
        if loaded is None:
            return None
        return true_depth_in_unit(loaded[0], self.unit, still, static)

    def result(self, instants: Sequence[Instant], why: str) -> StereoComparison:
        """Scores of both conditions."""
        assert self.pair is not None
        tallies = {condition: Tally() for condition in CONDITIONS}
        per_instant = []
        for one in instants:
            row: dict[str, float | int | None] = {
                "instant": one.now,
                "offset_instant": one.later,
                "mover_pixels": int(one.moving.sum()),
            }
            reference = self.dataset.grey(self.reference, one.now)
            for condition, later in (("synced", one.now), ("offset", one.later)):
                found = one.maps[condition]
                other = self.dataset.grey(self.other, later)
                measured = Measurements()
                for kind, mask in (("mover", one.moving), ("static", one.static)):
                    measured.update(measure_depth(found.depth, found.difference, mask, one.truth), f"{kind}_")
                    errors = epipolar_errors(self.pair, reference, other, mask)
                    measured.medians[f"{kind}_epipolar_px"] = np.array(errors, float)
                tallies[condition].add(measured)
                row |= {f"{condition}_{measure}": Tally([measured]).value(measure) for measure in ROW}
            per_instant.append(row)
        return StereoComparison(
            reference=self.reference,
            other=self.other,
            synced=tallies["synced"].scores(DepthScores),
            offset=tallies["offset"].scores(DepthScores),
            per_instant=tuple(per_instant),
            differences=differences(tallies["synced"], tallies["offset"], DepthScores),
            why=why,
        )
