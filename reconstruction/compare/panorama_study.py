"""The panorama study of a comparison: registered once, then measured in both conditions."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.drawing import box_with_most, enlarge_crop, trim_empty_sides
from reconstruction.common.geometry import Array
from reconstruction.compare.study import SIDES, ComparisonTally, Pair, PairStudy, write_pictures
from reconstruction.pairs.features import detect_features, match_features
from reconstruction.pairs.homography import fit_homography
from reconstruction.panorama.pair_panorama import (
    PairRegistration,
    blend_pair,
    correct_parallax,
    measure_misfit,
    panorama_masks,
    register_pair,
    uncalibrated_view,
    undistort_pixels,
)
from reconstruction.scores.results import PanoramaComparison, PanoramaScores, Picture
from reconstruction.scores.tally import Tally, measures_of
from reconstruction.session.conditions import Condition
from reconstruction.session.frame_offset import FrameOffset
from reconstruction.session.mover_detection import dilate

REGISTRATION_INSTANTS = 3
FEWEST_GREY_LEVELS = 12
"""A difference between the conditions smaller than this is noise."""
TEXTS = {
    "panorama": ("Panorama", "Two pictures laid side by side and cross-faded where they overlap."),
    "panorama_closeup": (
        "Where they overlap, close up",
        "A thing that moved between the two pictures is there twice, half transparent.",
    ),
}


class PanoramaStudy(PairStudy):
    """A panorama of two cameras, synchronized and offset; images of uncalibrated cameras stay distorted."""

    subject = "panorama"

    def __init__(self, rig: Rig, offset: FrameOffset | None, asked: Pair | None, max_instants: int) -> None:
        super().__init__(rig, offset, asked, max_instants)
        self.registration: PairRegistration | None = None

    def prepare(self, middle: int, progress: Progress) -> None:
        """Choose the pair, and register its pictures of the same instants.

        Raises:
            ValueError: no two cameras suit, or their pictures make no panorama.
        """
        self.use_pair(self.rig.choose_panorama_pair(self.asked, middle))
        progress.step(f"registering {self.cameras[0]} and {self.cameras[1]}")
        self.registration = self._register([now for now, _ in self.instant_pairs(self.condition)[0]])

    def _register(self, instants: Sequence[int]) -> PairRegistration:
        """Fix the geometry from what stands still.

        Raises:
            ValueError: the two cameras' pictures make no panorama.
        """
        first, second = self.cameras
        views = [
            self.rig.views.get(name) or uncalibrated_view(*self.dataset.size(name)) for name in self.cameras
        ]
        at: tuple[list[Array], list[Array]] = ([], [])
        for now in instants[:: max(1, len(instants) // REGISTRATION_INSTANTS)]:
            points = [
                detect_features(self.dataset.grey(name, now), self.motion.widened_movers(name, now))
                for name in self.cameras
            ]
            found = match_features(points[0], points[1])
            for kept, view, pixels in zip(at, views, found, strict=True):
                kept.append(undistort_pixels(view, pixels) if len(pixels) else pixels)
        homography = fit_homography(
            np.concatenate(at[0]), np.concatenate(at[1]), self.dataset.size(first), self.dataset.size(second)
        )
        if homography is None:
            raise ValueError(f"the pictures of {first} and {second} cannot be registered to each other")
        rough = register_pair(views[0], views[1], homography)
        moving = np.zeros(rough.overlap.shape, bool)
        for which, name in enumerate(self.cameras):
            for k in self.dataset.instants(name):
                mask = self.motion.detected_movers(name, k).astype(np.uint8)
                moving |= rough.warp(mask, which, nearest=True) > 0
        return correct_parallax(
            rough,
            rough.warp(self.motion.background(first), 0),
            rough.warp(self.motion.background(second), 1),
            dilate(moving, 4),
        )

    def compare(
        self, condition: Condition, progress: Progress, folder: Path | None = None
    ) -> PanoramaComparison:
        """As `Study.compare`; the misfit is measured in the overlap."""
        assert self.registration is not None
        first, second = self.cameras
        pairs, offset_ms = self.instant_pairs(condition)
        tally = ComparisonTally(PanoramaScores, measures_of(PanoramaScores))
        changes = Tally()
        for now, later in pairs:
            progress.step(f"panorama {first}-{second}, instant {now}")
            measured = {}
            for side, shown in zip(SIDES, (now, later), strict=True):
                measured[side] = measure_misfit(
                    self.registration,
                    self.dataset.grey(first, now),
                    self.dataset.grey(second, shown),
                    *self._masks(now, later, shown),
                )
            tally.add(measured, {"instant": now, "offset_instant": later})
            changes.add(measured["offset"].minus(measured["synced"]))
        return PanoramaComparison(
            cameras=self.cameras,
            synced=tally.synced,
            offset=tally.offset,
            offset_ms=offset_ms,
            per_instant=tally.per_instant,
            differences=changes.intervals(measures_of(PanoramaScores)),
            pictures=self._pictures(pairs, folder) if folder else (),
            reason=self.reason,
        )

    def _pictures(self, pairs: Sequence[tuple[int, int]], out: Path) -> tuple[Picture, ...]:
        """The panorama of the instant at which most moves in the overlap, and a close-up, both conditions."""
        assert self.registration is not None
        first, second = self.cameras
        overlap = self.registration.overlap
        moving = [int((self._masks(now, later, later)[0] & overlap).sum()) for now, later in pairs]
        now, later = pairs[int(np.argmax(moving))]
        photos = {
            side: (self.dataset.image(first, now), self.dataset.image(second, shown))
            for side, shown in zip(SIDES, (now, later), strict=True)
        }
        return _draw_panorama(self.registration, photos, out)

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


def _draw_panorama(
    registration: PairRegistration, photos: Mapping[str, tuple[Array, Array]], out: Path
) -> tuple[Picture, ...]:
    """Blend both cameras' photos (BGR) of each side into pictures in out/pictures."""
    part = trim_empty_sides(registration.seen[0] | registration.seen[1])
    wholes = {side: blend_pair(registration, *pair)[part] for side, pair in photos.items()}
    changed = np.abs(wholes["synced"].astype(np.float32) - wholes["offset"]).mean(2)
    box = box_with_most(changed * (changed > FEWEST_GREY_LEVELS), 0.5)
    closeups = {side: enlarge_crop(whole, box) for side, whole in wholes.items()}
    drawn = {side: {"panorama": wholes[side], "panorama_closeup": closeups[side]} for side in SIDES}
    return write_pictures(drawn, TEXTS, out)
