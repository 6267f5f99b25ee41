"""Moments of a scene with depth, computed by the installed method for depth from all cameras."""

from collections.abc import Iterator, Sequence

from capture_app.console.terminal import Progress
from reconstruction.depth.seen_moment import SeenInstant
from reconstruction.method.interface import SILENT, find_method
from reconstruction.scene.conditions import SYNCHRONIZED, Condition
from reconstruction.scene.scene import Scene

DEPTH = "multiview"
"""Name of the method that computes depth maps."""


def see_moments(
    scene: Scene,
    instants: Sequence[int],
    condition: Condition = SYNCHRONIZED,
    *,
    without: Sequence[str] = (),
    quick: bool = False,
    min_evidence: float | None = None,
    progress: Progress = SILENT,
) -> Iterator[SeenInstant]:
    """Yield each instant with depth of all cameras that have it, under a condition.

    Several instants share what stands still. Cameras `without` take no part, nor does depth of less than
    `min_evidence` (-2 to 1.5). Raises as the method does.
    """
    method = find_method(
        DEPTH,
        instants=tuple(instants),
        without=tuple(without),
        quick=quick,
        min_evidence=min_evidence,
        progress=progress,
    )
    yield from method.see(scene, condition)
