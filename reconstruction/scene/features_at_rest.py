"""Features of a session's images, detected once: all of them, and those at rest."""

from collections.abc import Callable
from typing import Self

from reconstruction.common.worker_pool import computed_once
from reconstruction.scene.moving_pixels import SceneMotion
from reconstruction.scene.pairs import FAINT_CONTRAST, Features, detect_features


class SceneFeatures:
    """Features by camera and instant; threads that ask for the same ones compute them once."""

    def __init__(self, motion: SceneMotion, same_images: Self | None = None) -> None:
        """`same_images`: features of the same images, for another motion."""
        self.dataset, self.motion = motion.dataset, motion
        # Some MB of features each.
        self.of_image: Callable[[str, int], Features] = (
            same_images.of_image
            if same_images
            else computed_once(
                lambda camera, k: detect_features(self.dataset.grey(camera, k), contrast=FAINT_CONTRAST),
                64,
            )
        )
        """The features of an image, also on moving objects."""
        self.at_rest = computed_once(self._at_rest, 9)
        """Each camera's features at rest in the image nearest to an instant."""

    @property
    def middle(self) -> dict[str, Features]:
        """The features at rest at the middle of the session."""
        return self.at_rest(len(self.dataset.instants_ns) // 2)

    def _at_rest(self, instant: int) -> dict[str, Features]:
        there = {name: self.dataset.instants(name) for name in self.dataset.cameras}
        nearest = {
            name: min(pixels, key=lambda k: abs(k - instant)) for name, pixels in there.items() if pixels
        }
        return {
            name: self.of_image(name, k).at_rest(self.motion.widened_moving(name, k))
            for name, k in nearest.items()
        }
