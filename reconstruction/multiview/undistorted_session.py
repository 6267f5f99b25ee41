"""A session's images, masks and true depth, undistorted and reduced in size for a comparison."""

from functools import lru_cache

import cv2
import numpy as np

from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import Array, View, resize_view
from reconstruction.multiview.input_images import (
    InputImage,
    undistort_image,
    undistort_nearest,
)
from reconstruction.session.dataset import Dataset
from reconstruction.session.moving_pixels import SceneMotion, dilate

CACHED_IMAGES = 32


class UndistortedSession:
    """Images, moving pixels and true depth by camera and instant, at most `width_px` wide."""

    def __init__(self, dataset: Dataset, motion: SceneMotion, views: dict[str, View], width_px: int) -> None:
        self.dataset = dataset
        self.motion = motion
        self.full_views = views
        self.views = {name: _small(view, width_px) for name, view in views.items()}
        self._image = lru_cache(maxsize=CACHED_IMAGES)(self._load)

    def problem(self, camera: str, instant: int) -> str:
        """Return why there is no image to match; empty if there is one."""
        if camera not in self.views:
            return "it is not in the calibration"
        if not self.dataset.has_image(camera, instant):
            return f"it has no image of instant {instant}"
        found = self._image(camera, instant)
        return found if isinstance(found, str) else ""

    def image(self, camera: str, instant: int) -> InputImage:
        """Return the image; it must be usable."""
        found = self._image(camera, instant)
        assert isinstance(found, InputImage)
        return found

    def moving(self, camera: str, instant: int) -> Array:
        """Return the motion mask (bool)."""
        return self.undistort_mask(camera, self.motion.moving(camera, instant))

    def changing(self, camera: str, instant: int) -> Array:
        """Return the widened mask of motion and change (bool): pixels that the still control leaves out."""
        mask = self.undistort_mask(camera, self.motion.changing(camera, instant))
        return dilate(mask, max(3, mask.shape[1] // 80))

    def true_depth(self, camera: str, instant: int) -> Array | None:
        """Return true depth (m, 0 = unknown), undistorted, at the reduced size; None if unknown."""
        loaded = self.dataset.ground_truth(camera, instant)
        return None if loaded is None else self._undistort_small(camera, loaded[0])

    def undistort_mask(self, camera: str, mask: Array) -> Array:
        """Undistort and resize a mask (bool) of the session's original pixels."""
        return self._undistort_small(camera, mask.astype(np.uint8)) > 0

    def _undistort_small(self, camera: str, image: Array) -> Array:
        view = self.views[camera]
        small = cv2.resize(image, (view.width, view.height), interpolation=cv2.INTER_NEAREST)
        return undistort_nearest(view, np.asarray(small))

    def _load(self, camera: str, instant: int) -> InputImage | str:
        view = self.views[camera]
        image = self.dataset.image(camera, instant)
        if image.shape[1] != view.width:
            size = (view.width, view.height)
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        try:
            return undistort_image(camera, instant, image, view)
        except BadInputError as error:
            return error.what


def _small(view: View, width_px: int) -> View:
    scale = width_px / view.width
    return view if scale >= 1 else resize_view(view, width_px, round(view.height * scale))
