"""Masks of what moves in each image of a burst, each detected once."""

from functools import lru_cache

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.session.dataset import Dataset
from reconstruction.session.mover_detection import detect_movers, dilate, median_background

MARGIN_PX = 5


class SceneMotion:
    """Masks of moving pixels (bool, height x width) by camera and instant."""

    def __init__(self, dataset: Dataset, step: int) -> None:
        """`step`: an image is compared with those so many instants before and after it."""
        self.dataset = dataset
        self.step = step
        self._moving = lru_cache(maxsize=None)(self._by_difference)
        self._still = lru_cache(maxsize=None)(self._background)

    def detected_movers(self, camera: str, instant: int) -> Array:
        """What moves by the images alone; no computation uses other knowledge."""
        return self._moving(camera, instant)

    def widened_movers(self, camera: str, instant: int) -> Array:
        """What moves, and `MARGIN_PX` around it: what calibration and registration must leave out."""
        return dilate(self.detected_movers(camera, instant), MARGIN_PX)

    def moving(self, camera: str, instant: int) -> Array:
        """What truly moves where the session knows it, else what is detected: for scores only."""
        truth = self.dataset.ground_truth(camera, instant)
        return truth[1] if truth is not None else self._moving(camera, instant)

    def changing(self, camera: str, instant: int) -> Array:
        """What moves or changes, such as a shadow: pixels that the still control must leave out."""
        return np.asarray(self.moving(camera, instant) | self._moving(camera, instant))

    def background(self, camera: str) -> Array:
        """The camera's still background, grey uint8."""
        return self._still(camera)

    def _background(self, camera: str) -> Array:
        return median_background([self.dataset.grey(camera, k) for k in self.dataset.instants(camera)])

    def _by_difference(self, camera: str, instant: int) -> Array:
        there = self.dataset.instants(camera)
        near = [k for k in (instant - self.step, instant + self.step) if k in there]
        if not near:
            near = [k for k in there if k != instant][:1]
        return detect_movers(
            self.dataset.grey(camera, instant),
            [self.dataset.grey(camera, k) for k in near],
            self._still(camera),
        )
