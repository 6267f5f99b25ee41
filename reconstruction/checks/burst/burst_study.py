"""The burst as a grid of small pictures: a row for each camera, a column for each instant."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from reconstruction.common.image_files import save_picture
from reconstruction.method.score import Score
from reconstruction.method.study_result import StudyResult
from reconstruction.method.words import read_words
from reconstruction.scene.conditions import evenly_spaced
from reconstruction.scene.dataset import Dataset

MAX_CAMERAS, MAX_INSTANTS = 20, 8
WIDTH_PX = 160


class BurstStudy(Score):
    """Study with small pictures of the burst, which show the source of delayed images."""

    text = read_words(__package__)

    @classmethod
    def files(cls, found: StudyResult[dict[str, Any]]) -> dict[str, Sequence[str]]:
        """Return the grid's pictures; see `Score.files`."""
        return {"the burst": [path for row in found.facts["thumbnails"] for path in row if path]}

    def measure(self) -> StudyResult[Any]:
        """Write the grid; see `Score.measure`."""
        assert self.context.folder is not None
        grid = _render(self.dataset, self.context.folder)
        return StudyResult(
            name=self.text.name, cameras=grid["cameras"], instants=len(grid["instants"]), facts=grid
        )


def _render(dataset: Dataset, out: Path) -> dict[str, Any]:
    """Write the thumbnails into out/pictures; a long burst is sampled at evenly spaced instants.

    Returns a grid: a row of paths ("" = no image) for each of the `cameras`, with a column for each of the
    `instants`, whose `times_ms` count from the burst's first instant.
    """
    times_ns = dataset.instants_ns
    instants = evenly_spaced(range(len(times_ns)), MAX_INSTANTS)
    cameras = dataset.cameras[:MAX_CAMERAS]

    def thumbnail(camera: str, instant: int) -> str:
        if not dataset.has_image(camera, instant):
            return ""
        image = dataset.image(camera, instant)
        scale = WIDTH_PX / image.shape[1]
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        return save_picture(out, f"burst_{camera}_{instant:06d}.jpg", np.asarray(small))

    return {
        "cameras": tuple(cameras),
        "instants": instants,
        "times_ms": [(times_ns[k] - times_ns[0]) / 1e6 for k in instants],
        "thumbnails": [[thumbnail(camera, k) for k in instants] for camera in cameras],
    }
