"""Masks of movers as files, for programs that leave out or keep what moves."""

from pathlib import Path

import cv2
import numpy as np
from msgspec import Struct

from capture_app.errors import NotApplicableError
from capture_app.session.files.output_folder import OutputFolder, replaces_nothing
from capture_app.terminal import Progress
from reconstruction.session.dataset import Dataset
from reconstruction.session.mover_detection import SceneMotion


class MoverMasks(Struct, frozen=True, kw_only=True):
    """What was written: the number of masks, and by camera the mean share of its pixels that move."""

    masks: int
    moving: dict[str, float]


def write_masks(dataset: Dataset, out: Path, progress: Progress | None = None) -> MoverMasks:
    """Write OUT/<camera>/<instant>.png for every image, white where something moves and a little around it.

    `progress` gets a step for each camera.

    Raises:
        NotApplicableError: a camera has fewer than two images to compare.
        BadInputError: there is something else at `out`.
    """
    motion = SceneMotion(dataset, step=1)
    few = [camera for camera in dataset.cameras if len(dataset.instants(camera)) < 2]
    if few:
        raise NotApplicableError(
            f"{', '.join(few)} has fewer than two images: what moves is seen by comparing them",
            hint="take a burst of several instants",
        )
    shares: dict[str, float] = {}
    progress = progress or Progress(len(dataset.cameras))
    with OutputFolder(out, replaces_nothing) as output:
        for camera in dataset.cameras:
            progress.step(camera)
            # The dataset may be smaller than its session, where memory is short.
            facts = dataset.session.camera(camera).facts
            masks = output.folder / camera
            masks.mkdir()
            moving = []
            for instant in dataset.instants(camera):
                mask = motion.widened_movers(camera, instant)
                moving.append(float(mask.mean()))
                white = mask.astype(np.uint8) * 255
                full = cv2.resize(white, (facts.width, facts.height), interpolation=cv2.INTER_NEAREST)
                (masks / f"{instant:06d}.png").write_bytes(cv2.imencode(".png", full)[1].tobytes())
            shares[camera] = sum(moving) / len(moving)
    return MoverMasks(masks=sum(len(dataset.instants(camera)) for camera in shares), moving=shares)
