"""Panorama of one instant: the method, its options and its words."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from capture_app.common.errors import BadInputError
from capture_app.session.format.manifest import MANIFEST
from reconstruction.common.options import Pair, command_flag, flag
from reconstruction.method.interface import Method
from reconstruction.scene.conditions import SYNCHRONIZED, Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.methods.panorama.panorama_run import PanoramaResult, RegisteredInstant
    from reconstruction.scene.scene import Scene


class Panorama(Method, frozen=True, kw_only=True):
    """Panorama of one instant of a session, or of images; also of late images, under a condition."""

    name = "panorama"
    study = f"{__package__}.panorama_study:PanoramaStudy"
    help = (
        "Stitch a panorama from one instant of SESSION, or from image files or a folder of them.\n\n"
        "Lists the images that were left out and why, and marks ghosting in the panorama."
    )
    examples = (
        "panorama sessions/burst-001 --out panorama",
        "panorama left.jpg right.jpg --out panorama",
    )
    takes_images = True

    instants: tuple[int, ...] | None = None
    """Instants of `run`; None = `instant` alone."""
    register_at: Annotated[
        int | None,
        command_flag(
            "--register-at",
            ge=0,
            metavar="K",
            show_default="as --instant",
            help="Register the images of this instant, by what stands still.",
        ),
    ] = None
    pair: Annotated[
        Pair | None,
        command_flag("--pair", show_default="all cameras", help="Stitch these two cameras only."),
        flag("--panorama-pair", "panorama", help="The two cameras for the panorama."),
    ] = None

    def save(self, scene: "Scene", condition: Condition, output: "OutputFolder") -> "PanoramaResult":
        """Stitch an instant, and also under the condition if that is another one; see `Method.save`."""
        from reconstruction.methods.panorama.panorama_run import session_input, stitch

        given = session_input(scene, condition, self.instant, self.pair, self.register_at)
        return stitch(given, output.folder)

    def run(self, scene: "Scene", condition: Condition) -> "Iterator[RegisteredInstant]":
        """Yield the registered images of the `pair`, else of all cameras, at each instant."""
        from reconstruction.methods.panorama.panorama_run import register_instants

        yield from register_instants(
            scene,
            condition,
            scene.dataset.chosen_instants(self.listed_instants),
            scene.named_pair(self.pair) or scene.dataset.cameras,
            self.register_at,
        )

    def compute(self, sources: "Sequence[Path | Scene]", condition: Condition, output: "OutputFolder") -> Any:
        """Stitch a session, or images; see `Method.compute`."""
        from reconstruction.methods.panorama.panorama_run import image_input, stitch

        images = [source for source in sources if isinstance(source, Path)]
        if len(sources) == 1 and (not images or (images[0] / MANIFEST).exists()):
            return super().compute(sources, condition, output)
        needs_session = {
            "--condition": condition != SYNCHRONIZED,
            "--time-shift-ms": bool(self.time_shifts_ms),
            "--pair": self.pair is not None,
            "--register-at": self.register_at is not None,
        }
        if given := [option for option, is_given in needs_session.items() if is_given]:
            raise BadInputError(
                f"{given[0]} needs a session: single pictures have no times",
                hint=f"give a session, or leave out {given[0]}",
            )
        return stitch(image_input(images), output.folder)

    def notes(self, result: Any) -> Iterator[str]:
        """Yield nothing: the lines name what was left out."""
        yield from ()
