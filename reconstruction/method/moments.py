"""Moments of a scene with depth, computed by the installed method for depth from all cameras."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.console.terminal import Progress
from capture_app.session.exporting.exported_burst import mask_path
from capture_app.session.format.camera_labels import pair_labels
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import read_image
from reconstruction.depth.seen_moment import SeenInstant
from reconstruction.method.interface import SILENT, find_method
from reconstruction.scene.conditions import SYNCHRONIZED, Condition
from reconstruction.scene.instant_choice import instants_shown
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
    masks: str | None = None,
    progress: Progress = SILENT,
) -> Iterator[SeenInstant]:
    """Yield each instant with depth of all cameras that have it, under a condition.

    Several instants share what stands still. Cameras `without` take no part, nor does depth whose log odds of
    being right are below `min_evidence`. Outside `masks`, a folder, pictures are black and without depth.

    Raises as the method does, and as `read_mask`.
    """
    method = find_method(
        DEPTH,
        instants=tuple(instants),
        without=tuple(without),
        quick=quick,
        min_evidence=min_evidence,
        progress=progress,
    )
    for seen in method.see(scene, condition):
        if masks is not None:
            shown = instants_shown(scene.dataset, condition, seen.instant)
            moment = {
                camera: seen_view.within(read_mask(scene, masks, camera, shown[camera]))
                for camera, seen_view in seen.moment.items()
            }
            seen = seen._replace(moment=moment)
        yield seen


def read_mask(scene: Scene, masks: str, camera: str, instant: int) -> Array:
    """Return where a mask, DIR/CAMERA/INSTANT.png, is white in a camera's undistorted picture (bool).

    Raises:
        BadInputError: it is missing, or not an image.
    """
    view, folder = scene.views[camera], Path(masks)
    labels = pair_labels(sorted(place.name for place in folder.glob("*/")), scene.dataset.labels)
    path = mask_path(folder, labels.get(camera, camera), scene.dataset.record(camera, instant).instant)
    if not path.is_file():
        raise BadInputError(f"{path} is missing", hint="reconstruct movers makes masks of all images")
    mask = view.undistort_image(cv2.resize(read_image(path), (view.width, view.height)))
    return np.asarray(mask[..., 0] > 127)
