"""A panorama of any number of pictures: registered once, composed for each condition, judged before blending.

Registration, projection, seams, exposure and blending are OpenCV's (Brown and Lowe 2007).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from capture_app.errors import BadInputError
from reconstruction.common.geometry import Array
from reconstruction.pairs.features import MIN_MATCHES, Features, detect_features, match_features
from reconstruction.panorama.ghosting import OverlapScore, all_seen, mark_ghosts

MAX_SIDE_PX = 2000
"""Larger pictures are made smaller: panoramas of full camera pictures take minutes."""


@dataclass(frozen=True)
class Panorama:
    """The picture (BGR), the same with ghosts marked, and the overlaps it was judged by."""

    picture: Array
    ghosts: Array
    overlaps: tuple[OverlapScore, ...]


class PanoramaStitcher:
    """Pictures registered once; `used` are in the panorama, `left_out` says why the others are not."""

    def __init__(self, images: Mapping[str, Array], movers: Mapping[str, Array] | None = None) -> None:
        """Register BGR pictures by features outside of their `movers` (bool).

        Raises:
            BadInputError: the pictures make no panorama.
        """
        if len(images) < 2:
            raise BadInputError("a panorama takes two pictures or more", hint="name more pictures")
        small = {name: limit_size(image) for name, image in images.items()}
        self.used = self._register(small, movers)
        self.left_out: dict[str, str] = {}
        while len(self.used) < len(small) - len(self.left_out):
            for name in small:
                if name not in self.used and name not in self.left_out:
                    self.left_out[name] = _reason_left_out(name, self.used, small)
            # A stitcher that has left a picture out reads beyond its pictures when it composes others.
            self.used = self._register({name: small[name] for name in self.used}, movers)

    def _register(self, small: Mapping[str, Array], movers: Mapping[str, Array] | None) -> tuple[str, ...]:
        """Register pictures; the names of those that belong together."""
        masks = [
            cv2.resize(
                np.where(movers[name], 0, 255).astype(np.uint8) if movers else all_seen(image),
                image.shape[1::-1],
                interpolation=cv2.INTER_NEAREST,
            )
            for name, image in small.items()
        ]
        cv2.setRNGSeed(0)
        self._stitcher = cv2.Stitcher.create(cv2.Stitcher_PANORAMA)
        try:
            status = self._stitcher.estimateTransform(list(small.values()), masks)
        except cv2.error as error:
            raise BadInputError(f"the pictures cannot be registered: {error.err}") from error
        if status != cv2.Stitcher_OK:
            raise BadInputError(
                f"the pictures make no panorama: {_registration_problem(status, small)}",
                hint="take them from one place, with a third of overlap between neighbours",
            )
        names = list(small)
        return tuple(names[i] for i in np.asarray(self._stitcher.component()).ravel())

    def compose(self, images: Mapping[str, Array]) -> Panorama:
        """The panorama of pictures of the same cameras, of this or another condition.

        Raises:
            BadInputError: the composed picture is too small or too large for a panorama.
        """
        small = [limit_size(images[name]) for name in self.used]
        cv2.setRNGSeed(0)
        try:
            status, picture = self._stitcher.composePanorama(small)
        except cv2.error as error:
            raise BadInputError(f"the panorama cannot be composed: {error.err}") from error
        if status != cv2.Stitcher_OK:
            raise BadInputError("the panorama cannot be composed")
        self._refuse_misfit(np.asarray(picture), small)
        ghosts, overlaps = mark_ghosts(self._stitcher, self.used, small)
        return Panorama(np.asarray(picture), ghosts, tuple(overlaps))

    def _refuse_misfit(self, picture: Array, small: list[Array]) -> None:
        height, width = picture.shape[:2]
        least = min(min(image.shape[:2]) for image in small) // 2
        area = sum(image.shape[0] * image.shape[1] for image in small)
        if min(height, width) < least or height * width > 6 * area:
            raise BadInputError(
                f"the pictures do not fit together: a panorama of {width}x{height} pixels",
                hint="take them from one place, with a third of overlap between neighbours",
            )


def limit_size(image: Array) -> Array:
    """The picture, at most MAX_SIDE_PX long."""
    scale = min(1.0, MAX_SIDE_PX / max(image.shape[:2]))
    if scale == 1.0:
        return image
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _features(image: Array) -> Features:
    return detect_features(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.zeros(image.shape[:2], bool))


def _registration_problem(status: int, small: Mapping[str, Array]) -> str:
    points = {name: _features(image) for name, image in small.items()}
    best = max(len(match_features(points[a], points[b])[0]) for a, b in combinations(points, 2))
    if best < MIN_MATCHES:
        return f"no two of them share more than {best} points"
    if status == cv2.Stitcher_ERR_CAMERA_PARAMS_ADJUST_FAIL:
        return "no rotation of a single camera explains them"
    return "the points they share do not fit a camera that only rotates"


def _reason_left_out(name: str, used: tuple[str, ...], small: Mapping[str, Array]) -> str:
    own = _features(small[name])
    if len(own.positions) < MIN_MATCHES:
        return f"it has too few features ({len(own.positions)})"
    shared = {other: len(match_features(own, _features(small[other]))[0]) for other in used}
    nearest = max(shared, key=lambda other: shared[other])
    if shared[nearest] < MIN_MATCHES:
        return f"it shares at most {shared[nearest]} points with another picture ({nearest})"
    return f"it shares {shared[nearest]} points with {nearest}, but does not fit beside it"
