"""Images prepared for matching: undistorted, grey, with their noise level."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from capture_app.common.errors import BadInputError, NotApplicableError
from reconstruction.common.geometry import Array, View, resize_view
from reconstruction.common.memory import memory_budget
from reconstruction.common.worker_pool import SWEEP_BYTES, computed_once, max_workers
from reconstruction.depth.calibrated_image import CalibratedImage, matching_noise
from reconstruction.scene.calibration.consistency import CalibrationCheck, check_rig
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion, dilate
from reconstruction.scene.pairs import detect_features
from reconstruction.scene.scene import Scene

MIN_CONTRAST = 2.0
"""Standard deviation of grey levels (of 255) below which an image is empty."""


@dataclass(frozen=True, eq=False)
class InputImage:
    """One camera's image: undistorted colours (uint8 height x width x 3), and in grey with its view."""

    camera: str
    instant: int
    colours: Array
    calibrated: CalibratedImage
    view: View
    """The view with the image's original distortion."""
    step_ns: int = 0
    """The camera's step in a staggered rig; images of one step show one moment."""

    @property
    def outside(self) -> Array:
        """The undistorted pixels (bool) that the original image does not contain, and those at its edge."""
        if self.view.lens.is_straight:
            return np.zeros(self.colours.shape[:2], bool)
        there = undistort_nearest(self.view, np.ones(self.colours.shape[:2], np.uint8))
        # The edge of what is filled with black is no edge of an object: nothing is matched within 2 px of it.
        inside = cv2.erode(there, np.ones((5, 5), np.uint8), borderValue=1)
        return np.asarray(inside == 0)


def undistort_nearest(view: View, image: Array) -> Array:
    """Undistort an image by nearest neighbour, at the view's size."""
    image = cv2.resize(image, (view.width, view.height), interpolation=cv2.INTER_NEAREST)
    if view.lens.is_straight:
        return image
    maps = view.lens.maps((view.width, view.height), view.matrix)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_NEAREST))


def undistorted_truth(dataset: Dataset, view: View, camera: str, instant: int) -> tuple[Array, Array] | None:
    """Return an image's true depth (m, 0 = unknown) and motion mask (bool), undistorted; None if unknown."""
    if (truth := dataset.ground_truth(camera, instant)) is None:
        return None
    return undistort_nearest(view, truth[0]), undistort_nearest(view, truth[1].astype(np.uint8)) > 0


def undistort_image(camera: str, instant: int, image: Array, view: View) -> InputImage:
    """Undistort an image (uint8 height x width x 3, BGR).

    Raises:
        BadInputError: the image is empty.
    """
    colours = view.undistort_image(image)
    grey = cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY)
    if float(grey.std()) < MIN_CONTRAST:
        raise BadInputError(
            "its image has the same brightness everywhere",
            hint="uncover the lens or add light, or choose another instant",
        )
    matched = view.undistorted, grey.astype(np.float32), 5, matching_noise(grey)
    photo = CalibratedImage(*matched, colours=np.ascontiguousarray(colours))
    return InputImage(camera, instant, colours, photo, view)


def prepare_images(scene: Scene, width_px: int | None = None) -> "InputImages":
    """Return a scene's images at a width, None = one at which depth of all cameras fits the memory budget.

    Raises:
        NotApplicableError: it has one camera only.
        BadInputError: it takes too much memory at any size, or has no calibration.
    """
    cameras = len(scene.dataset.cameras)
    scene.dataset.require_cameras(2, "depth needs two that see the same from different places")
    if width_px is not None:
        return InputImages(scene, width_px)
    workers = max_workers()
    # Each camera's image, rays, surface, depth and normals; a worker's sources, voters and what is between.
    fitted = scene.fitted(
        images=cameras,
        bytes_per_pixel=60 + workers * 300 / cameras,
        fixed_bytes=min(workers * SWEEP_BYTES, 0.4 * memory_budget().limit_bytes),
        fraction=0.9,
    )
    return InputImages(fitted)


def check_images(images: Mapping[str, InputImage]) -> CalibrationCheck:
    """Check the images' calibration against points at rest in them, of one instant."""
    views = {camera: image.calibrated.view for camera, image in images.items()}
    features = {}
    for camera, image in images.items():
        moving = image.calibrated.moving
        # By 800 points of images up to 960 px.
        features[camera] = detect_features(
            cv2.cvtColor(image.colours, cv2.COLOR_BGR2GRAY),
            960,
            800,
            allowed=None if moving is None else ~moving,
        )
    return check_rig(views, features)


class InputImages:
    """A scene's images for matching, by camera and instant, with what moves and the true depth of each.

    Images wider than `width_px` are reduced to it; None = no limit.
    """

    def __init__(
        self,
        scene: Scene,
        width_px: int | None = None,
        motion: SceneMotion | None = None,
    ) -> None:
        """`motion`: what moves, for scores. Runs and scores of one scene share images of a limited width.

        Raises as `Scene.views`.
        """
        self.scene, self.dataset, self.motion = scene, scene.dataset, motion or scene.motion
        self.views = {
            name: resize_view(view, width_px, round(view.height * (width_px / view.width)))
            if width_px is not None and view.width > width_px
            else view
            for name, view in scene.views.items()
        }
        self.plain_views = {name: view.undistorted for name, view in self.views.items()}
        """The views of undistorted images."""
        self._image = self._load
        if width_px is not None:
            self._image = scene.once(("images", width_px), lambda: computed_once(self._load, 32))

    def usable(self, shown: Mapping[str, int]) -> tuple[dict[str, InputImage], dict[str, str]]:
        """Return the images that can be matched, of each camera's instant, and reasons for the others.

        Raises:
            NotApplicableError: fewer than two images are usable.
        """
        found = {camera: self._image(camera, instant) for camera, instant in shown.items()}
        images = {camera: image for camera, image in found.items() if isinstance(image, InputImage)}
        left_out = {camera: why for camera, why in found.items() if isinstance(why, str)}
        if len(images) < 2:
            reasons = "; ".join(f"{camera}: {why}" for camera, why in left_out.items())
            raise NotApplicableError(
                f"fewer than two cameras can be used ({reasons})",
                hint="depth needs two that are calibrated and see the same from different places",
            )
        return images, left_out

    def problem(self, camera: str, instant: int) -> str:
        """Return why there is no image to match; empty if there is one."""
        image = self._image(camera, instant)
        return image if isinstance(image, str) else ""

    def image(self, camera: str, instant: int) -> InputImage:
        """Return the image; it must be usable."""
        image = self._image(camera, instant)
        assert isinstance(image, InputImage)
        return image

    def moving(self, camera: str, instant: int) -> Array:
        """Return the mask (bool) of moving pixels of an undistorted image, for scores."""
        return self.undistort_mask(camera, self.motion.moving(camera, instant))

    def changing(self, camera: str, instant: int) -> Array:
        """Return the widened mask of motion and change (bool): pixels that the still control leaves out."""
        mask = self.undistort_mask(camera, self.motion.changing(camera, instant))
        return dilate(mask, max(3, mask.shape[1] // 80))

    def true_depth(self, camera: str, instant: int) -> Array | None:
        """Return true depth (m, 0 = unknown), undistorted; None if unknown."""
        loaded = self.dataset.ground_truth(camera, instant)
        return None if loaded is None else undistort_nearest(self.views[camera], loaded[0])

    def undistort_mask(self, camera: str, mask: Array) -> Array:
        """Undistort and resize a mask (bool) of the session's original pixels."""
        return undistort_nearest(self.views[camera], mask.astype(np.uint8)) > 0

    def _load(self, camera: str, instant: int) -> InputImage | str:
        """Return an image, or why it cannot be matched."""
        if (view := self.views.get(camera)) is None:
            return "it is not in the calibration"
        if not self.dataset.has_image(camera, instant):
            return f"it has no image of instant {instant}"
        image = self.dataset.image(camera, instant)
        if image.shape[1] != view.width:
            image = cv2.resize(image, (view.width, view.height), interpolation=cv2.INTER_AREA)
        try:
            undistorted = undistort_image(camera, instant, image, view)
        except BadInputError as error:
            return error.what
        moving = None
        # Planes are fitted to blank walls, not to what moves in front; nor is that part of the still scene.
        if len(self.dataset.instants(camera)) > 1:
            moving = self.undistort_mask(camera, self.scene.motion.widened_moving(camera, instant))
        step_ns = self.dataset.steps_ns[camera]
        return replace(
            undistorted, calibrated=replace(undistorted.calibrated, moving=moving), step_ns=step_ns
        )
