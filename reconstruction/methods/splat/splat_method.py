"""Gaussian splats of a moment: the method, its options and its words."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from capture_app.common.text import count
from reconstruction.common.options import command_flag, flag
from reconstruction.method.interface import Method
from reconstruction.scene.conditions import Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.methods.splat.splat_run import SplatMoment, SplatResult
    from reconstruction.scene.scene import Scene


MIN_EVIDENCE = -0.5
"""Evidence of depth below which a pixel gives no Gaussian: less than half of such pixels are right."""


class SplatMethod(Method, frozen=True, kw_only=True):
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

    instants: Annotated[
        tuple[int, ...] | None,
        command_flag(
            "--instants",
            metavar="all|K-L,M,...",
            help="Make a splat of each of these instants instead of one.",
        ),
    ] = None
    """Instants in order, empty = all; None = `instant` alone."""
    without: Annotated[
        tuple[str, ...], command_flag("--without", metavar="CAMERA,...", help="Leave these cameras out.")
    ] = ()
    masks: Annotated[
        str | None,
        command_flag(
            "--masks",
            metavar="DIR",
            help="Show only what is white in the masks DIR/CAMERA/INSTANT.png, such as those of "
            "`reconstruct movers`.",
        ),
    ] = None
    iterations: Annotated[
        int,
        command_flag(
            "--iterations",
            ge=0,
            le=10_000,
            metavar="N",
            help="How often each camera's picture is compared. 2 for a quick look.",
        ),
    ] = 10
    all_cameras: Annotated[
        bool,
        command_flag(
            "--all-cameras",
            help="Use all cameras. By default, the middle one of four or more is left out, and its picture "
            "judges the splat.",
        ),
    ] = False
    width: Annotated[
        int,
        command_flag(
            "--width",
            ge=160,
            metavar="PX",
            help="Reduce larger pictures to this length of their longer side.",
        ),
    ] = 960
    quick: Annotated[
        bool,
        command_flag("--quick", help="Take half the time for depth; thin parts and edges are less accurate."),
    ] = False

    page: Annotated[
        bool, command_flag("--page", help="Also write walk.html, a page that plays the splats.")
    ] = False
    spz: Annotated[
        bool, command_flag("--spz", help="Also write each splat as .spz, a fifth of the .ply's size.")
    ] = False
    splats: Annotated[
        bool,
        flag(
            "--splats",
            help="Also make a splat of one instant without one of four or more cameras, and compare it with "
            "that camera's picture. Takes about half a minute.",
        ),
    ] = False

    def output_folder(self, out: Path) -> "OutputFolder":
        """Return the folder that replaces earlier splats; see `Method.output_folder`."""
        from capture_app.session.files.output_folder import OutputFolder, replaces_only
        from reconstruction.methods.splat.splat_run import OURS

        return OutputFolder(out, replaces_only(OURS | {self.result_file}))

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
        there = [c for c in scene.known_views if c not in self.without and dataset.has_image(c, first)]
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

    def lines(self, result: Any, out: Path) -> Iterator[str]:
        """Yield the number of splats and their size, and how well they match; see `Method.lines`."""
        mean = sum(instant.gaussians for instant in result.instants) / len(result.instants)
        judged = [one.held_out_psnr for one in result.instants if one.held_out_psnr is not None]
        match = (
            f"at least {min(judged):.1f} dB to the picture of {result.held_out}, which was left out"
            if judged
            else f"at least {min(one.psnr for one in result.instants):.1f} dB to the pictures they were made "
            "from; no camera was left out to judge them"
        )
        yield f"{count(len(result.instants), 'splat')} of {mean:,.0f} Gaussians in {result.seconds:.1f} s"
        yield match
        yield from (f"splat: {out / instant.file}" for instant in result.instants[:1])
        if self.page:
            from reconstruction.pages.walk_page import PAGE

            yield f"page: {out / PAGE}"
        yield from super().lines(result, out)
