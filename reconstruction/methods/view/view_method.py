"""Views of a moment from places without a camera: the method, its options and its words."""

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from capture_app.common.errors import BadInputError
from capture_app.common.optional_packages import load_optional
from capture_app.common.text import count
from capture_app.session.format.calibration import CameraCalibration
from reconstruction.common.options import command_flag
from reconstruction.method.interface import Method
from reconstruction.scene.conditions import Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.methods.view.view_run import ViewResult
    from reconstruction.scene.scene import Scene

FILMS = (".mp4", ".gif", ".webp")
"""Suffixes of `--out` for a film alone."""


class ViewMethod(Method, frozen=True, kw_only=True):
    """Pictures along a path, blended from the cameras' pictures through their depth maps."""

    name = "view"
    made = f"{__package__}.view_run:MadeView"
    help = (
        "Show one instant of SESSION from places without a camera, as a film along a path.\n\n"
        "--out is a film (.mp4, .gif, .webp), or a folder for pictures. Of a staggered rig, two or more "
        "cameras must share each step; each step is a moment of its own."
    )
    examples = (
        "view sessions/burst-001 --out swing.mp4",
        "view sessions/burst-001 --instants all --path orbit --out orbit.mp4",
        "view sessions/burst-001 --instants all --path still --out still.mp4",
        "view sessions/burst-001 --path cameras.json --out views",
        "view sessions/burst-001 --instants all --page --out walk",
    )
    result_file = "view.json"

    path: Annotated[
        str | tuple[CameraCalibration, ...],
        command_flag(
            "--path",
            metavar="swing|orbit|still|FILE",
            help="Path of the camera: from one end of the rig to the other and back, on an ellipse, still in "
            "the middle with one picture of each moment, or the cameras of a file (calibration.json, or "
            "nerfstudio's camera path) in their order.",
        ),
    ] = "swing"
    """`swing`, `orbit`, `still`, a file, or cameras."""
    frames: Annotated[
        int, command_flag("--frames", ge=2, le=10_000, metavar="N", help="Pictures of swing and orbit.")
    ] = 90
    fps: Annotated[
        float | None,
        command_flag(
            "--fps",
            gt=0,
            le=240,
            metavar="FPS",
            show_default="30; as recorded with --path still",
            help="Pictures a second of the film.",
        ),
    ] = None
    instants: Annotated[
        tuple[int, ...] | None,
        command_flag(
            "--instants",
            metavar="all|K-L,M,...",
            help="Let time pass over these instants along the path, instead of standing still.",
        ),
    ] = None
    """Instants in order, empty = all; None = `instant` alone."""
    quick: Annotated[
        bool, command_flag("--quick", help="Take half the time; thin parts and edges are less accurate.")
    ] = False

    page: Annotated[
        bool, command_flag("--page", help="Also write walk.html, a page to walk round in; --out is a folder.")
    ] = False

    def output_folder(self, out: Path) -> "OutputFolder":
        """Return the folder that replaces earlier views; see `Method.output_folder`."""
        from capture_app.session.files.output_folder import OutputFolder, replaces_only
        from reconstruction.methods.view.view_run import OURS

        return OutputFolder(out, replaces_only(OURS | {self.result_file}))

    def write(self, sources: "Sequence[Path | Scene]", out: Path, condition: Condition) -> Any:
        """Write a folder of pictures, or a film if `out` is named like one; see `Method.write`."""
        if out.suffix.lower() not in FILMS:
            return super().write(sources, out, condition)
        from reconstruction.methods.view.view_run import write_film

        if self.page:
            raise BadInputError("--page needs a folder as --out", hint=f"--out {out.stem}")
        if out.exists() or out.is_symlink():
            raise BadInputError(f"{out} exists already", hint="name a film that does not exist yet")
        if out.suffix.lower() == ".mp4":
            load_optional("av", "export", "a film as MP4", hint="--out NAME.gif needs no package")
        with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
            result = super().write(sources, Path(scratch, "made"), condition)
            write_film(out, Path(scratch, "made"), result)
        return result

    def save(self, scene: "Scene", condition: Condition, output: "OutputFolder") -> "ViewResult":
        """Compute depth, and render the views; see `Method.save`."""
        from reconstruction.methods.view.view_run import render_views

        return render_views(
            scene,
            condition,
            output.folder,
            path=self.path,
            frames=self.frames,
            fps=self.fps,
            instants=self.listed_instants,
            quick=self.quick,
            page=self.page,
            progress=self.progress,
        )

    def lines(self, result: Any, out: Path) -> Iterator[str]:
        """Yield the number of views, and how much of them was seen; see `Method.lines`."""
        what = "instant" if result.steps == 1 else "moment"
        instants = f", {count(len(result.instants), what)}" if len(result.instants) > 1 else ""
        seen = f"{100 * result.seen:.0f} % of their pixels seen by a camera"
        yield f"{count(result.frames, 'view')} of {count(len(result.cameras), 'camera')}{instants}; {seen}"
        if self.page:
            from reconstruction.pages.walk_page import PAGE

            yield f"page: {out / PAGE}"
        yield from super().lines(result, out)
