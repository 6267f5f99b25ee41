"""Gaussian splats of a moment: the method, its options and its words."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from capture_app.session.format.camera_labels import require_camera
from reconstruction.methods.splat.splat_options import SplatOptions
from reconstruction.scene.conditions import Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.methods.splat.splat_run import SplatMoment, SplatResult
    from reconstruction.scene.scene import Scene


MIN_EVIDENCE = -0.2
"""Log odds of a right depth below which a pixel gives no Gaussian: those of 45 %."""


class SplatMethod(SplatOptions, frozen=True, kw_only=True):
    """A Gaussian splat of an instant, made from depth maps and optimized without a GPU."""

    name = "splat"
    study = f"{__package__}.splat_study:SplatStudy"
    made = f"{__package__}.splat_run:MadeSplat"
    help = (
        "Make a Gaussian splat of one instant of SESSION: a .ply for viewers of 3D Gaussian Splatting.\n\n"
        "Needs no GPU."
    )
    examples = (
        "splat sessions/burst-001 --instant 3 --out splat",
        "splat sessions/burst-001 --instants 0-24 --iterations 5 --out splats",
        "splat sessions/burst-001 --instants all --page --out splats",
    )
    result_file = "splat.json"
    ours = f"{__package__}.splat_run:OURS"

    def save(self, scene: "Scene", condition: Condition, output: "OutputFolder") -> "SplatResult":
        """Compute depth, and optimize the splats; see `Method.save`."""
        from reconstruction.methods.splat.splat_run import make_splats

        return make_splats(
            scene,
            self.run(scene, condition),
            output.folder,
            condition,
            self,
            held_out=self.held_out(scene),
        )

    def held_out(self, scene: "Scene") -> str:
        """Return the camera that is left out to judge the splats; empty if all are used."""
        from reconstruction.methods.splat.splat_run import middle_camera

        dataset = scene.dataset
        first, *_ = dataset.chosen_instants(self.listed_instants)
        without = {require_camera(text, dataset.labels, "--without") for text in self.without}
        there = [c for c in scene.known_views if c not in without and dataset.has_image(c, first)]
        return "" if self.all_cameras else middle_camera({c: scene.views[c] for c in there})

    def run(self, scene: "Scene", condition: Condition) -> "Iterator[SplatMoment]":
        """Yield the splat of each instant; see `Method.run`."""
        from reconstruction.method.moments import see_moments
        from reconstruction.methods.splat.splat_run import optimize_moments

        chosen = scene.dataset.chosen_instants(self.listed_instants)
        seen = see_moments(
            scene,
            chosen,
            condition,
            without=tuple(filter(None, (*self.without, self.held_out(scene)))),
            quick=self.quick,
            min_evidence=MIN_EVIDENCE,
            masks=self.masks,
            progress=self.progress,
        )
        yield from optimize_moments(seen, len(chosen), self)
