"""Depth from one pair of cameras: the method, its options and its words."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

from capture_app.common.errors import BadInputError
from reconstruction.common.options import Pair, command_flag, flag
from reconstruction.method.interface import Method
from reconstruction.scene.conditions import Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.methods.stereo.stereo_run import PairInstant, StereoDepth
    from reconstruction.scene.scene import Scene


class Stereo(Method, frozen=True, kw_only=True):
    """Depth from one pair of cameras, with its confidence.

    `pair` None = chosen.
    """

    name = "stereo"
    study = f"{__package__}.stereo_study:StereoStudy"
    made = f"{__package__}.stereo_run:MadeStereo"
    help = "Compute a depth map from two cameras of SESSION, with its confidence and a picture."
    examples = ("stereo sessions/burst-001 --pair cam00,cam01 --out depth",)

    instants: tuple[int, ...] | None = None
    """Instants of `run`; None = `instant` alone."""
    pair: Annotated[
        Pair | None,
        command_flag("--pair", help="The two cameras for the depth map."),
        flag("--stereo-pair", "stereo", help="The two cameras for depth."),
    ] = None

    def save(self, scene: "Scene", condition: Condition, output: "OutputFolder") -> "StereoDepth":
        """Match the pair densely; see `Method.save`."""
        from reconstruction.methods.stereo.stereo_run import compute_stereo

        return compute_stereo(
            scene,
            condition,
            output.folder,
            instant=self.instant,
            asked=self.pair,
            progress=self.progress,
        )

    def run(self, scene: "Scene", condition: Condition) -> "Iterator[PairInstant]":
        """Yield the checked depth of the `pair` at each instant; see `Method.run`."""
        from reconstruction.methods.stereo.stereo_run import match_pair
        from reconstruction.scene.instant_choice import instants_shown

        if self.pair is None:
            raise BadInputError("no pair is named", hint='pair=("left", "right")')
        first, second = self.pair
        shown = [instants_shown(scene.dataset, condition, k) for k in self.listed_instants]
        yield from match_pair(
            scene, self.pair, [(picture[first], picture[second]) for picture in shown], lean=True
        )

    def notes(self, result: Any) -> Iterator[str]:
        """Yield the cameras and the pairs that were left out; see `Method.notes`."""
        from reconstruction.scene.pairs import describe_left_out

        yield from super().notes(result)
        if result.pairs_left_out:
            yield f"left out: {describe_left_out(result.pairs_left_out)}"
