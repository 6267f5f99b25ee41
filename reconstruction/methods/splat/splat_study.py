"""A splat of synchronized and of delayed images, beside the picture of a camera that was left out."""

from collections.abc import Mapping
from pathlib import Path
from typing import Self

import msgspec
import numpy as np

from reconstruction.common.drawing import box_around, enlarge_crop
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import save_picture
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.phrases import EACH_DELAYED
from reconstruction.method.picture_quality import psnr, ssim
from reconstruction.method.score import UNASKED, Score
from reconstruction.method.study_result import Picture, StudyResult
from reconstruction.method.tally import Measurements, Tally
from reconstruction.method.words import read_words
from reconstruction.methods.splat.gaussians import render_gaussians
from reconstruction.methods.splat.splat_method import SplatMethod
from reconstruction.methods.splat.splat_run import MIN_CAMERAS, middle_camera
from reconstruction.scene.conditions import SYNCHRONIZED, Condition
from reconstruction.scene.instant_choice import (
    ShownInstant,
    complete_instants,
    relative_offsets_ms,
)
from reconstruction.scene.moving_pixels import dilate

ITERATIONS = 6
WIDTH_PX = 640
MARGIN_PX = 4
"""Margin around what moves, within which a pixel belongs to it."""
SPARE = 0.15
"""Margin of the close-up, relative to what moves."""
WORSE_DB = 1.0


class SplatFacts(msgspec.Struct, frozen=True, kw_only=True):
    """Results that only the study of splats has."""

    instant: int
    reference: str
    """The camera that was left out, whose picture the splats are compared with."""
    made_from: tuple[str, ...]
    iterations: int
    gaussians: dict[str, int]
    """Number of Gaussians by condition."""
    picture: str
    """Path of the left-out camera's picture, undistorted; empty without a folder."""


Splat = tuple[Array, int]
"""What the left-out camera would see of a splat, and how many Gaussians it has."""


class SplatStudy(Score):
    """A splat of one instant in any condition, judged by the picture of a camera that was left out."""

    text = read_words(__package__)
    needs_calibration = True
    min_cameras = MIN_CAMERAS
    Options = SplatMethod

    reference = ""
    """The camera that is left out; empty before `prepare` chooses it."""

    @classmethod
    def placeholders(cls, found: StudyResult[SplatFacts]) -> dict[str, str]:
        """Return values for the names in braces; see `Score.placeholders`."""
        facts = found.facts
        return super().placeholders(found) | {
            "reference": facts.reference,
            "made_from": f"{len(facts.made_from)} cameras",
            "iterations": f"{facts.iterations}",
        }

    @classmethod
    def verdict(cls, result: CompareResult, found: StudyResult[SplatFacts]) -> str:
        """Return by how much a splat of delayed pictures is worse where something moves."""
        known = found.first_known("mover_psnr", "psnr")
        if known is None or known[1] - known[2] < WORSE_DB:
            return ""
        when = "pictures of one instant" if result.together(found.cameras) else "the pictures as recorded"
        what = "what moves" if known[0] == "mover_psnr" else "the scene"
        return (
            f"A splat of {when} shows {what} to a camera that was left out at a PSNR of {known[1]:.1f} dB; "
            f"with {EACH_DELAYED}, {known[2]:.1f} dB."
        )

    @property
    def steps(self) -> int:
        """Number of progress lines: one for each condition."""
        return 0 if self.unasked() else 2

    def unasked(self) -> str:
        """Return a reason unless splats are asked for, as they take a while; see `Score.unasked`."""
        asked = self.options.splats or self.text.name in self.context.studies
        return "" if asked else f"{UNASKED} (--splats makes it)"

    def adopt(self, ours: Self) -> None:
        """Leave out the same camera as in the comparison's own session."""
        self.reference = ours.reference

    def prepare(self) -> None:
        """Choose the camera that is left out: the one nearest to the middle of all.

        Raises:
            ValueError: fewer than four cameras are calibrated, or the calibration was found for this
                comparison alone.
        """
        if self.scene.given is None:
            raise ValueError("it needs a session with a calibration: reconstruct calibrate writes one")
        self.cameras = tuple(name for name in self.dataset.cameras if name in self.scene.views)
        if len(self.cameras) < MIN_CAMERAS:
            raise ValueError(f"it needs {MIN_CAMERAS} calibrated cameras")
        if self.reference not in self.cameras:
            self.reference = middle_camera({name: self.scene.views[name] for name in self.cameras})
        self.made = dict[tuple[object, ...], Splat]()

    def compare(self, condition: Condition, folder: Path | None = None) -> StudyResult[SplatFacts]:
        """Compare a condition at the instant with most motion; see `Score.compare`.

        Raises:
            ValueError: the burst does not contain this condition, or no three cameras have depth.
        """
        shown = self._instant(condition)
        late = condition.kept_at(self.reference)
        splats = {
            "synced": self._splat("synced", shown, SYNCHRONIZED),
            "offset": self._splat("offset", shown, late),
        }
        view = self.scene.views[self.reference]
        truth = view.undistort_image(self.dataset.image(self.reference, shown.instant))
        moving, still = self._masks(view, shown)
        tally = Tally()
        measured = {side: _scores(picture, truth, moving, still) for side, (picture, _) in splats.items()}
        tally.add(measured, {"instant": shown.instant, **shown.delays_ms(self.dataset)})
        pictures, path = tuple[Picture, ...](), ""
        if folder is not None:
            path = save_picture(folder, f"splat_{self.reference}.jpg", truth)
            pictures = self._pictures(splats, truth, moving, folder)
        return StudyResult(
            name=self.text.name,
            cameras=self.cameras,
            instants=tally.instants,
            offsets_ms=relative_offsets_ms(condition, self.dataset, self.reference, self.cameras),
            commands=self.commands(self.method(shown), late),
            measures=tally.measures,
            per_instant=tally.per_instant,
            pictures=pictures,
            facts=SplatFacts(
                instant=shown.instant,
                reference=self.reference,
                made_from=tuple(name for name in shown.shown if name != self.reference),
                iterations=ITERATIONS,
                gaussians={side: number for side, (_, number) in splats.items()},
                picture=path,
            ),
        )

    def _instant(self, condition: Condition) -> ShownInstant:
        """Return the instant with most motion of those that most cameras show in both conditions."""
        moments = complete_instants(self.dataset, condition, self.reference, self.cameras, MIN_CAMERAS)
        chosen = self.moving_moments(moments, (self.reference,), len(moments))
        return max(
            chosen, key=lambda one: float(self.motion.detected_moving(self.reference, one.instant).mean())
        )

    def method(self, one: ShownInstant) -> SplatMethod:
        """Return the method whose results are scored, with the options of its command."""
        options: SplatMethod = self.options
        return msgspec.structs.replace(
            options,
            instants=(one.instant,),
            without=tuple(c for c in self.dataset.cameras if c == self.reference or c not in one.shown),
            all_cameras=True,
            iterations=ITERATIONS,
            width=WIDTH_PX,
            quick=True,
        )

    def _splat(self, side: str, one: ShownInstant, condition: Condition) -> Splat:
        """Return the splat of an instant's pictures without the reference; the same one is made once."""
        shown = one.by_condition[side]
        if (known := self.made.get(key := (one.instant, *shown.items()))) is not None:
            return known
        self.progress.step(f"a splat without {self.reference}, {side}")
        ((_, splat),) = self.method(one).run(self.scene, condition)
        picture = render_gaussians(splat, self.scene.views[self.reference].undistorted)
        self.made[key] = picture, len(splat)
        return self.made[key]

    def _masks(self, view: View, shown: ShownInstant) -> tuple[Array, Array]:
        """Return what moves in the reference's picture, and what stands still in all of its pictures."""
        moving = self.motion.moving(self.reference, shown.instant)
        changing = [
            self.motion.changing(self.reference, k)
            for k in {shown.instant, *shown.shown.values()}
            if self.dataset.has_image(self.reference, k)
        ]
        masks = dilate(moving, MARGIN_PX), dilate(np.logical_or.reduce(changing), 2 * MARGIN_PX)
        seen, any_change = (view.undistort_image(np.uint8(255) * one) > 127 for one in masks)
        return seen, ~any_change

    def _pictures(
        self, splats: Mapping[str, Splat], truth: Array, moving: Array, folder: Path
    ) -> tuple[Picture, ...]:
        """Write the whole splats, and close-ups of what moves beside the reference's own picture."""
        drawn = {side: {"splat": picture} for side, (picture, _) in splats.items()}
        if moving.any():
            box = box_around(moving, spare=SPARE, aspect=moving.shape[1] / moving.shape[0])
            for side, (picture, _) in splats.items():
                drawn[side]["splat_close"] = np.hstack([enlarge_crop(one, box) for one in (truth, picture)])
        return self.write_pictures(drawn, folder, reference=self.reference)


def _scores(picture: Array, truth: Array, moving: Array, still: Array) -> Measurements:
    """Return PSNR and SSIM of a picture against the truth as a whole, where something moves, and at rest."""
    found = {"psnr": psnr(picture, truth), "ssim": ssim(picture, truth)}
    masks = {"mover_psnr": moving, "static_psnr": still}
    found |= {name: psnr(picture, truth, mask) for name, mask in masks.items() if mask.any()}
    return Measurements(means={name: np.array([value]) for name, value in found.items()})
