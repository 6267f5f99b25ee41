"""The panorama half of a comparison: registered once, composed and measured for both conditions."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.terminal import Progress
from reconstruction.calibration.features import detect_features, match_features
from reconstruction.calibration.homography import fit_homography
from reconstruction.common.drawing import box_with_most, enlarge_crop, save_picture, trim_empty_sides
from reconstruction.common.geometry import Array, View
from reconstruction.panorama.pair_panorama import OverlapMisfit, blend_pair, measure_misfit, panorama_masks
from reconstruction.panorama.pair_registration import (
    PairRegistration,
    correct_parallax,
    register_pair,
    uncalibrated_view,
    undistort_pixels,
)
from reconstruction.scores.panorama_results import PanoramaComparison, PanoramaScores
from reconstruction.scores.results import Picture
from reconstruction.scores.tally import Measurements, Tally, measures_of
from reconstruction.session.dataset import Dataset
from reconstruction.session.mover_detection import dilate
from reconstruction.session.scene_motion import SceneMotion

REGISTRATION_INSTANTS = 3


class PanoramaStudy:
    """A panorama of two cameras, synchronized and offset."""

    def __init__(
        self,
        dataset: Dataset,
        motion: SceneMotion,
        views: dict[str, View],
        cameras: tuple[str, str],
        pairs: Sequence[tuple[int, int]],
    ) -> None:
        """`pairs` are (instant, later instant); cameras without a view are taken as they are."""
        self.dataset = dataset
        self.motion = motion
        self.cameras = cameras
        self.pairs = list(pairs)
        self.views = [views.get(name) or uncalibrated_view(*dataset.size(name)) for name in cameras]
        self.registration: PairRegistration | None = None

    def register(self) -> None:
        """Fix the geometry from what stands still.

        Raises:
            ValueError: the two cameras' pictures make no panorama.
        """
        first, second = self.cameras
        at: tuple[list[Array], list[Array]] = ([], [])
        for now, _ in self.pairs[:: max(1, len(self.pairs) // REGISTRATION_INSTANTS)]:
            points = [
                detect_features(self.dataset.grey(name, now), self.motion.widened_movers(name, now))
                for name in self.cameras
            ]
            found = match_features(points[0], points[1])
            for kept, view, pixels in zip(at, self.views, found, strict=True):
                kept.append(undistort_pixels(view, pixels) if len(pixels) else pixels)
        homography = fit_homography(
            np.concatenate(at[0]),
            np.concatenate(at[1]),
            self.dataset.size(first),
            self.dataset.size(second),
        )
        if homography is None:
            raise ValueError(f"the pictures of {first} and {second} cannot be laid over each other")
        rough = register_pair(self.views[0], self.views[1], homography)
        moving = np.zeros(rough.overlap.shape, bool)
        for which, name in enumerate(self.cameras):
            for k in self.dataset.instants(name):
                mask = self.motion.detected_movers(name, k).astype(np.uint8)
                moving |= rough.warp(mask, which, nearest=True) > 0
        self.registration = correct_parallax(
            rough,
            rough.warp(self.motion.background(first), 0),
            rough.warp(self.motion.background(second), 1),
            dilate(moving, 4),
        )

    def result(self, progress: Progress, why: str) -> PanoramaComparison:
        """Misfit of both conditions in the overlap, the mean over the instants."""
        assert self.registration is not None
        first, second = self.cameras
        misfits: tuple[list[OverlapMisfit], list[OverlapMisfit]] = ([], [])
        for now, later in self.pairs:
            progress.step(f"panorama {first}-{second}, instant {now}")
            for shown, instant in enumerate((now, later)):
                moving, still = self._masks(now, later, instant)
                misfits[shown].append(
                    measure_misfit(
                        self.registration,
                        self.dataset.grey(first, now),
                        self.dataset.grey(second, instant),
                        moving,
                        still,
                    )
                )
        changes = Tally(map(_measurements, misfits[1], misfits[0]))
        return PanoramaComparison(
            cameras=self.cameras,
            synced=Tally(map(_measurements, misfits[0])).scores(PanoramaScores),
            offset=Tally(map(_measurements, misfits[1])).scores(PanoramaScores),
            differences=changes.intervals(measures_of(PanoramaScores)),
            why=why,
        )

    def pictures(self, out: Path) -> list[Picture]:
        """The panorama of the instant at which most moves in the overlap, and a close-up, both conditions."""
        assert self.registration is not None
        first, second = self.cameras
        now, later = max(self.pairs, key=lambda pair: int(self._moving(*pair).sum()))
        seen = self.registration.seen[0] | self.registration.seen[1]
        part = trim_empty_sides(seen)
        wholes = {
            condition: blend_pair(
                self.registration, self.dataset.image(first, now), self.dataset.image(second, instant)
            )[part]
            for condition, instant in (("synced", now), ("offset", later))
        }
        changed = np.abs(wholes["synced"].astype(np.float32) - wholes["offset"]).mean(2)
        box = box_with_most(changed * (changed > 12), 0.5)
        paths: dict[str, dict[str, str]] = {"panorama": {}, "closeup": {}}
        for condition, whole in wholes.items():
            paths["panorama"][condition] = save_picture(out, f"panorama_{condition}.jpg", whole)
            close = enlarge_crop(whole, box)
            paths["closeup"][condition] = save_picture(out, f"panorama_closeup_{condition}.jpg", close)
        return [
            Picture(
                key="panorama",
                title="Panorama",
                caption="Two pictures laid side by side and cross-faded where they overlap.",
                synced=paths["panorama"]["synced"],
                offset=paths["panorama"]["offset"],
            ),
            Picture(
                key="panorama_closeup",
                title="Where they overlap, close up",
                caption="A thing that moved between the two pictures is there twice, half transparent.",
                synced=paths["closeup"]["synced"],
                offset=paths["closeup"]["offset"],
            ),
        ]

    def _masks(self, now: int, later: int, shown: int) -> tuple[Array, Array]:
        """Moving and still pixels on the panorama when the second camera shows the instant `shown`."""
        assert self.registration is not None
        first, second = self.cameras
        return panorama_masks(
            self.registration,
            (self.motion.moving(first, now), self.motion.moving(second, shown)),
            (
                [self.motion.changing(first, k) for k in (now, later) if self.dataset.has_image(first, k)],
                [self.motion.changing(second, k) for k in (now, later)],
            ),
        )

    def _moving(self, now: int, later: int) -> Array:
        assert self.registration is not None
        return np.asarray(self._masks(now, later, later)[0] & self.registration.overlap)


def _measurements(misfit: OverlapMisfit, earlier: OverlapMisfit | None = None) -> Measurements:
    """An instant's misfit, or how it differs from another."""
    means = {}
    for measure in measures_of(PanoramaScores):
        value = getattr(misfit, measure)
        before = 0.0 if earlier is None else getattr(earlier, measure)
        if value is not None and before is not None:
            means[measure] = np.array([value - before])
    return Measurements(means=means)
