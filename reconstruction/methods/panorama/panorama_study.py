"""Panorama of two cameras: registered once, then measured in both conditions."""

from pathlib import Path

import msgspec
import numpy as np

from reconstruction.common.drawing import box_of_max_weight, enlarge_crop, trim_empty_borders
from reconstruction.common.geometry import Array
from reconstruction.method.score import Score
from reconstruction.method.study_result import Picture, StudyResult
from reconstruction.method.tally import Measurements, Tally
from reconstruction.method.words import read_words
from reconstruction.methods.panorama.composition import Layer, average_layers
from reconstruction.methods.panorama.overlap import Overlap, known, measure_misalignment, overlap_of
from reconstruction.methods.panorama.panorama_method import Panorama
from reconstruction.methods.panorama.panorama_run import RegisteredInstant, register_at
from reconstruction.scene.conditions import SYNCHRONIZED, Condition
from reconstruction.scene.moving_pixels import dilate

MIN_GREY_LEVELS = 12
"""Difference between the conditions below which it is noise."""
MIN_POINTS, MIN_PIXELS = 5, 50
"""Minimum number of points and of pixels for a measure."""


class PanoramaStudy(Score):
    """Panorama of two cameras, synchronized and offset, registered once by the still scene."""

    of_pair = True
    min_cameras = 2

    text = read_words(__package__)
    Options = Panorama

    def prepare(self) -> None:
        """Choose the pair, and register its images of the same instant.

        Raises:
            ValueError: no two cameras are suitable, or their images cannot be stitched.
        """
        self.use_pair(self.compared.choose_panorama_pair(self.asked, self.context.middle))
        first, second = self.cameras
        self.progress.step(f"registering {first} and {second}")
        instants, _ = self.instant_pairs(SYNCHRONIZED)
        now, _ = min(instants, key=lambda pair: abs(pair[0] - self.context.middle))
        self.stitcher = register_at(self.scene, self.cameras, now)
        """Registers, projects and composes the pair."""
        self.register_at = now
        images = {name: self.dataset.image(name, now) for name in self.cameras}
        if overlap_of(*self.stitcher.layers(images).values()) is None:
            raise ValueError(f"the pictures of {first} and {second} hardly overlap")

    def compare(self, condition: Condition, folder: Path | None = None) -> StudyResult[None]:
        """Measure a condition in the overlap, before seams and blending; see `Score.compare`."""
        first, second = self.cameras
        pairs, offsets_ms = self.instant_pairs(condition)
        options: Panorama = self.options
        nows = tuple(now for now, _ in pairs)
        method = msgspec.structs.replace(options, pair=self.pair, instants=nows, register_at=self.register_at)
        tally, late = Tally(), self.late_condition(condition, offsets_ms)
        both = (method.run(self.scene, at) for at in (SYNCHRONIZED, late))
        for synced, offset in zip(*both, strict=True):
            now, later = synced.instant, offset.shown[second]
            self.progress.step(f"panorama {first}-{second}, instant {now}")
            measured = {
                side: self._measure(result, later)
                for side, result in (("synced", synced), ("offset", offset))
            }
            tally.add(measured, {"instant": now, "offset_instant": later})
        moving = [measured["synced"].shares["mover_found"][1] for measured, _ in tally.rows]
        return StudyResult(
            name=self.text.name,
            cameras=self.cameras,
            instants=tally.instants,
            offsets_ms=offsets_ms,
            commands=self.commands(method, late),
            reason=self.reason,
            measures=tally.measures,
            per_instant=tally.per_instant,
            pictures=self._pictures(*pairs[int(np.argmax(moving))], folder) if folder else (),
        )

    def _layers(self, now: int, shown: int) -> dict[str, Layer]:
        first, second = self.cameras
        return self.stitcher.layers(
            {first: self.dataset.image(first, now), second: self.dataset.image(second, shown)}
        )

    def _measure(self, instant: RegisteredInstant, later: int) -> Measurements:
        """Measure misalignment where both cameras' images overlap, without a seam.

        It is measured on movers and on the control: pixels that are still at both the instant and `later`.
        """
        first, second = self.cameras
        now, shown = instant.shown[first], instant.shown[second]
        a, b = self._layers(now, shown).values()
        overlap = overlap_of(a, b)
        assert overlap is not None
        moving, other_moving = (
            # Of the same pixels as the command's scores, whatever the offset.
            overlap.crop(self.stitcher.layer_mask(name, self.scene.motion.moving(name, k)), layer.box)
            for name, k, layer in ((first, now, a), (second, shown, b))
        )
        changing = [
            overlap.crop(self.stitcher.layer_mask(name, self.motion.changing(name, k)), layer.box)
            for name, layer in ((first, a), (second, b))
            for k in (now, later)
            if self.dataset.has_image(name, k)
        ]
        # A point's window overlaps a moving object this near.
        still = ~dilate(np.logical_or.reduce(changing), 12)
        return _misalignment_of(overlap, moving, moving | other_moving, still)

    def _pictures(self, now: int, later: int, out: Path) -> tuple[Picture, ...]:
        """Draw an instant's panorama, a close-up, and the overlap before the seam, in both conditions."""
        canvas = self.stitcher.projection.canvas
        drawn: dict[str, dict[str, Array]] = {}
        for side, shown in {"synced": now, "offset": later}.items():
            layers = self._layers(now, shown)
            mean, count = average_layers(list(layers.values()), canvas)
            part = trim_empty_borders(count > 0)
            drawn[side] = {"panorama": self.stitcher.compose(layers)[part], "panorama_overlap": mean[part]}
        synced, offset = (picture["panorama_overlap"].astype(np.float32) for picture in drawn.values())
        changed = np.where(count[part] > 1, np.abs(synced - offset).mean(2), 0)
        box = box_of_max_weight(changed * (changed > MIN_GREY_LEVELS), 0.4)
        for one in drawn.values():
            one["panorama_closeup"] = enlarge_crop(one["panorama"], box)
            one["panorama_overlap"] = enlarge_crop(one["panorama_overlap"], box)
        return self.write_pictures(drawn, out)


def _misalignment_of(overlap: Overlap, moving: Array, moved: Array, still: Array) -> Measurements:
    """Return a panorama's measures; masks: motion in the first image, in either image, and still control."""
    matched_overlap = overlap.with_brightness_matched()
    (x, y), length = measure_misalignment(matched_overlap)
    difference = matched_overlap.difference
    measured = Measurements(medians={"overlap_misfit_px": known(length)})
    for kind, points, pixels in (("mover", moving, moved), ("static", still, still)):
        lengths = length[points[y, x]]
        matched = known(lengths)
        measured.shares[f"{kind}_found"] = len(matched), len(lengths)
        measured.means[f"{kind}_points"] = np.array([len(matched)])
        if len(matched) >= MIN_POINTS:
            measured.medians[f"{kind}_misfit_px"] = matched
        if (pixels & overlap.both).sum() >= MIN_PIXELS:
            measured.means[f"{kind}_overlap_mad"] = difference[pixels & overlap.both]
    return measured
