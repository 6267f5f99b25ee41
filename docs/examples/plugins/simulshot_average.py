"""The average of a camera's images."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from reconstruction.common.options import command_flag
from reconstruction.method.interface import Method
from reconstruction.scene.provenance import Provenance


class AverageResult(Provenance, frozen=True, kw_only=True):
    camera: str
    picture: str


class Average(Method, frozen=True, kw_only=True):
    name = "average"
    help = "Average images of the first camera of SESSION, from an instant on."
    examples = ("average sessions/burst-001 --out average",)

    count: Annotated[int, command_flag("--count", ge=1, metavar="N", help="Average this many images.")] = 4

    def save(self, scene: Any, condition: Any, output: Any) -> AverageResult:
        import numpy as np

        from reconstruction.common.image_files import save_picture

        dataset = scene.dataset
        camera = dataset.cameras[0]
        offsets_ms = condition.offsets_ms(dataset.cameras, self.instant)
        first = dataset.nearest_instants(self.instant, offsets_ms)[camera]
        instants = dataset.instants(camera)[first : first + self.count]
        mean = np.mean([dataset.image(camera, k) for k in instants], axis=0).astype(np.uint8)
        return AverageResult(camera=camera, picture=save_picture(output.folder, "average.png", mean))

    def lines(self, result: Any, out: Path) -> Iterator[str]:
        yield f"{result.camera}: {out / result.picture}"
