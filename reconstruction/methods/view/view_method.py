"""Views of a moment from places without a camera: the method, its options and its words."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture_app.common.errors import BadInputError
from capture_app.common.optional_packages import load_optional
from capture_app.console.option_rules import Rule
from reconstruction.methods.view.view_options import ViewOptions
from reconstruction.scene.conditions import Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.methods.view.view_run import ViewResult
    from reconstruction.scene.scene import Scene

FILMS = (".mp4", ".gif", ".webp")
"""Suffixes of `--out` for a film alone."""


class ViewMethod(ViewOptions, frozen=True, kw_only=True):
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
    rules = (Rule("--frames", "--path=swing|orbit"),)
    result_file = "view.json"
    ours = f"{__package__}.view_run:OURS"

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

        return render_views(scene, condition, output.folder, self)
