"""The average of the cameras' pictures at an instant: a method with its score."""

from collections.abc import Iterator
from typing import Annotated, Any

from reconstruction.common.options import command_flag
from reconstruction.method.interface import Method
from reconstruction.scene.provenance import Provenance


class AverageResult(Provenance, frozen=True, kw_only=True):
    picture: str


class Average(Method, frozen=True, kw_only=True):
    name = "average"
    study = "simulshot_average_score:AverageScore"
    help = "Average the pictures of the cameras of SESSION at an instant."
    examples = ("average sessions/burst-001 --out average",)

    instants: tuple[int, ...] | None = None
    count: Annotated[int, command_flag("--count", ge=1, metavar="N", help="Take this many cameras.")] = 4

    def run(self, scene: Any, condition: Any) -> Iterator[Any]:
        import numpy as np

        from reconstruction.scene.instant_choice import instants_shown

        for instant in scene.dataset.chosen_instants(self.listed_instants):
            shown = instants_shown(scene.dataset, condition, instant)
            images = [scene.dataset.image(*one) for one in shown.items() if scene.dataset.has_image(*one)]
            yield np.mean(images[: self.count], axis=0).astype(np.uint8)

    def save(self, scene: Any, condition: Any, output: Any) -> AverageResult:
        from reconstruction.common.image_files import save_picture

        (mean,) = self.run(scene, condition)
        return AverageResult(picture=save_picture(output.folder, "average.png", mean))
