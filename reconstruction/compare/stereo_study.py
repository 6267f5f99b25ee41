"""The stereo study of a comparison: depth of one pair at every usable instant, in both conditions."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np

from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.geometry import Array
from reconstruction.compare.stereo_pictures import StereoInstant, stereo_pictures
from reconstruction.compare.study import SIDES, ComparisonTally, Pair, PairStudy
from reconstruction.scores.depth_truth import true_depth_in_unit
from reconstruction.scores.results import DepthScores, StereoComparison
from reconstruction.scores.still_control import median_still_depth, project_into_other, still_pixels
from reconstruction.scores.tally import Measurements, measure_depth
from reconstruction.session.conditions import Condition
from reconstruction.session.frame_offset import FrameOffset
from reconstruction.stereo.stereo_pair import DepthMap, StereoPair, epipolar_errors, find_disparity_range

RANGE_INSTANTS = 8
PER_INSTANT = ("mover_coverage", "static_coverage", "mover_within_2pct", "mover_epipolar_px")


class StereoStudy(PairStudy):
    """Depth of a pair, synchronized and offset, with all that is fixed for both taken from synced images."""

    subject = "depth"

    def __init__(self, rig: Rig, offset: FrameOffset | None, asked: Pair | None, max_instants: int) -> None:
        """As `PairStudy`."""
        super().__init__(rig, offset, asked, max_instants)
        self._matcher = lru_cache(maxsize=1)(self._make_matcher)
        self._kept_still: tuple[Array, tuple[Array, Array]] | None = None

    def prepare(self, middle: int, progress: Progress) -> None:
        """Choose the pair.

        Raises:
            ValueError: no two cameras suit, or one of them has no calibration.
        """
        self.use_pair(self.rig.choose_stereo_pair(self.asked, middle))

    def compare(
        self, condition: Condition, progress: Progress, folder: Path | None = None
    ) -> StereoComparison:
        """As `Study.compare`."""
        pairs, offset_ms = self.instant_pairs(condition)
        result, instants = self.compare_instants(pairs, progress)
        pictures = stereo_pictures(self.dataset, self.cameras, instants, folder) if folder else ()
        return msgspec.structs.replace(result, offset_ms=offset_ms, pictures=pictures)

    def compare_instants(
        self, pairs: Sequence[tuple[int, int]], progress: Progress, range_instants: Sequence[int] = ()
    ) -> tuple[StereoComparison, list[StereoInstant]]:
        """Compute depth and scores of both conditions; `pairs` are (instant, instant of the second camera).

        The range of disparities is that of `range_instants`, or of the pairs' own.

        Raises:
            ValueError: the two views overlap too little.
        """
        rig, (reference, other) = self.rig, self.cameras
        views = rig.views[reference], rig.views[other]
        progress.step(f"depth range of {reference} and {other}")
        nows = tuple(range_instants) or tuple(now for now, _ in pairs)
        key = (reference, other, nows, repr(views))
        try:
            disparities = rig.stages.record(
                "disparities", tuple[float, float], lambda: self._disparities(nows), *key
            )
        except ValueError as error:
            raise ValueError(f"{reference} and {other}: {error}") from error
        matcher = self._matcher(self.cameras, disparities)
        maps = []
        for now, later in pairs:
            progress.step(f"stereo {reference}-{other}, instant {now}")
            shown = {"synced": now, "offset": later}
            maps.append({side: self._depth(matcher, disparities, now, k) for side, k in shown.items()})
        instants = self._instants(pairs, maps, matcher)
        tally = ComparisonTally(DepthScores, PER_INSTANT)
        for one in instants:
            pixels = int(one.moving.sum())
            facts = {"instant": one.now, "offset_instant": one.later, "mover_pixels": pixels}
            tally.add({side: self._measure(one, side) for side in SIDES}, facts)
        result = StereoComparison(
            reference=reference,
            other=other,
            synced=tally.synced,
            offset=tally.offset,
            per_instant=tally.per_instant,
            differences=tally.differences,
            reason=self.reason,
        )
        return result, instants

    def _make_matcher(self, cameras: Pair, disparities: tuple[float, float]) -> StereoPair:
        """The pair's matcher; its maps serve every condition."""
        reference, other = (self.rig.views[name] for name in cameras)
        return StereoPair(reference, other, disparities)

    def _projected(self, still: Array) -> tuple[Array, Array]:
        """As `project_into_other`; conditions on the same instants share it."""
        if self._kept_still is None or not np.array_equal(self._kept_still[0], still):
            reference, other = (self.rig.views[name] for name in self.cameras)
            self._kept_still = still, project_into_other(reference, other, still)
        return self._kept_still[1]

    def _disparities(self, nows: Sequence[int]) -> tuple[float, float]:
        reference, other = self.cameras
        chosen = nows[:: max(1, len(nows) // RANGE_INSTANTS)]
        images = [
            (
                self.dataset.grey(reference, now),
                self.dataset.grey(other, now),
                self.motion.detected_movers(reference, now),
            )
            for now in chosen
        ]
        return find_disparity_range((self.rig.views[reference], self.rig.views[other]), images)

    def _depth(self, matcher: StereoPair, disparities: tuple[float, float], now: int, shown: int) -> DepthMap:
        """Depth of the reference at an instant, with what the other camera shows, from the stages' folder."""
        rig, (reference, other) = self.rig, self.cameras
        made = rig.stages.arrays(
            "depth",
            lambda: vars(
                matcher.compute_depth(self.dataset.grey(reference, now), self.dataset.grey(other, shown))
            ),
            reference,
            other,
            repr((rig.views[reference], rig.views[other])),
            disparities,
            matcher.scale,
            now,
            shown,
        )
        return DepthMap(**made)

    def _instants(
        self, pairs: Sequence[tuple[int, int]], maps: Sequence[dict[str, DepthMap]], matcher: StereoPair
    ) -> list[StereoInstant]:
        """The pixels that every instant is measured on, the same in both conditions."""
        (reference, other), dataset, motion = self.cameras, self.dataset, self.motion
        moving = [motion.moving(reference, now) for now, _ in pairs]
        still = median_still_depth([one["synced"].depth for one in maps], moving)
        where, inside = self._projected(still)
        instants = []
        for (now, later), found, mask in zip(pairs, maps, moving, strict=True):
            times = {now, later}
            static = still_pixels(
                where,
                inside,
                [motion.changing(reference, k) for k in times if dataset.has_image(reference, k)],
                [motion.changing(other, k) for k in times],
            )
            loaded = dataset.ground_truth(reference, now)
            truth = None if loaded is None else true_depth_in_unit(loaded[0], self.rig.unit, still, static)
            instants.append(StereoInstant(now, later, found, mask & inside, static, truth, matcher))
        return instants

    def _measure(self, one: StereoInstant, side: str) -> Measurements:
        reference, other = self.cameras
        found = one.maps[side]
        images = self.dataset.grey(reference, one.now), self.dataset.grey(other, one.shown(side))
        measured = Measurements()
        masks = {"mover": one.moving, "static": one.static}
        errors = epipolar_errors(one.matcher, *images, tuple(masks.values()))
        for (kind, mask), off in zip(masks.items(), errors, strict=True):
            measured.update(measure_depth(found.depth, found.difference, mask, one.truth), f"{kind}_")
            measured.medians[f"{kind}_epipolar_px"] = np.array(off, float)
        return measured
