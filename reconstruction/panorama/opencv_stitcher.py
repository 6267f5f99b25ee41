"""A panorama of any number of pictures: registered once, composed for each condition, judged before blending.

Registration, projection, seams, exposure and blending are OpenCV's (Brown and Lowe 2007).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from capture_app.errors import BadInputError
from reconstruction.calibration.features import FEWEST_MATCHES, Features, detect_features, match_features
from reconstruction.common.brightness import match_brightness
from reconstruction.common.geometry import Array

LONGEST_SIDE_PX = 2000
"""Larger pictures are made smaller: panoramas of full camera pictures take minutes."""
LEAST_OVERLAP_PX = 500
GHOST_GREY = 30.0
"""Where two pictures differ by more grey levels than this, they are marked as a ghost."""
GHOST = (40, 130, 250)


@dataclass(frozen=True)
class Overlap:
    """Where two pictures overlap: greatest displacement but for 5 %, px, and mean grey difference."""

    first: str
    second: str
    flow_p95_px: float
    mad: float


@dataclass(frozen=True)
class Panorama:
    """The picture (BGR), the same with ghosts marked, and the overlaps it was judged by."""

    picture: Array
    ghosts: Array
    overlaps: tuple[Overlap, ...]


class PanoramaStitcher:
    """Pictures registered once; `used` are in the panorama, `left_out` says why the others are not."""

    def __init__(self, images: Mapping[str, Array], movers: Mapping[str, Array] | None = None) -> None:
        """Register BGR pictures; `movers` (bool) are not looked at.

        Raises:
            BadInputError: the pictures make no panorama.
        """
        if len(images) < 2:
            raise BadInputError("a panorama takes two pictures or more", hint="name more pictures")
        small = {name: shrink(image) for name, image in images.items()}
        self.used = self._register(small, movers)
        self.left_out: dict[str, str] = {}
        while len(self.used) < len(small) - len(self.left_out):
            for name in small:
                if name not in self.used and name not in self.left_out:
                    self.left_out[name] = _why_alone(name, self.used, small)
            # A stitcher that has left a picture out reads beyond its pictures when it composes others.
            self.used = self._register({name: small[name] for name in self.used}, movers)

    def _register(self, small: Mapping[str, Array], movers: Mapping[str, Array] | None) -> tuple[str, ...]:
        """Register pictures; the names of those that belong together."""
        masks = [
            cv2.resize(
                np.where(movers[name], 0, 255).astype(np.uint8) if movers else _all(image),
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
                f"the pictures make no panorama: {_why_none(status, small)}",
                hint="take them from one place, each sharing a third of its view with the next",
            )
        names = list(small)
        return tuple(names[i] for i in np.asarray(self._stitcher.component()).ravel())

    def compose(self, images: Mapping[str, Array]) -> Panorama:
        """The panorama of pictures of the same cameras, of this or another condition.

        Raises:
            BadInputError: what comes out is no panorama.
        """
        small = [shrink(images[name]) for name in self.used]
        cv2.setRNGSeed(0)
        try:
            status, picture = self._stitcher.composePanorama(small)
        except cv2.error as error:
            raise BadInputError(f"the panorama cannot be composed: {error.err}") from error
        if status != cv2.Stitcher_OK:
            raise BadInputError("the panorama cannot be composed")
        self._check(np.asarray(picture), small)
        ghosts, overlaps = self._judge(small)
        return Panorama(np.asarray(picture), ghosts, tuple(overlaps))

    def _check(self, picture: Array, small: list[Array]) -> None:
        height, width = picture.shape[:2]
        least = min(min(image.shape[:2]) for image in small) // 2
        area = sum(image.shape[0] * image.shape[1] for image in small)
        if min(height, width) < least or height * width > 6 * area:
            raise BadInputError(
                f"the pictures do not fit together: a panorama of {width}x{height} pixels",
                hint="take them from one place, each sharing a third of its view with the next",
            )

    def _judge(self, small: list[Array]) -> tuple[Array, list[Overlap]]:
        """Warp every picture by itself and see how much they differ where they overlap."""
        scale = float(self._stitcher.workScale())
        cameras = self._stitcher.cameras()
        focal = float(np.median([camera.focal for camera in cameras]))
        warper = cv2.PyRotationWarper("spherical", focal)
        warped = []
        for image, camera in zip(small, cameras, strict=True):
            size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
            matrix, turn = camera.K().astype(np.float32), np.asarray(camera.R, np.float32)
            grey = cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
            corner, picture = warper.warp(grey, matrix, turn, cv2.INTER_LINEAR, cv2.BORDER_REFLECT)
            _, seen = warper.warp(_all(grey), matrix, turn, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)
            warped.append((corner, np.asarray(picture), np.asarray(seen) > 0))
        left, top = (min(corner[i] for corner, _, _ in warped) for i in (0, 1))
        width = max(corner[0] + picture.shape[1] for corner, picture, _ in warped) - left
        height = max(corner[1] + picture.shape[0] for corner, picture, _ in warped) - top
        layers = []
        for (x, y), picture, seen in warped:
            canvas, mask = np.zeros((height, width), np.float32), np.zeros((height, width), bool)
            part = slice(y - top, y - top + picture.shape[0]), slice(x - left, x - left + picture.shape[1])
            canvas[part], mask[part] = picture, seen
            layers.append((canvas, mask))
        worst = np.zeros((height, width), np.float32)
        overlaps = []
        for (i, a), (j, b) in combinations(enumerate(layers), 2):
            both = cv2.erode((a[1] & b[1]).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
            if both.sum() < LEAST_OVERLAP_PX:
                continue
            matched = match_brightness(a[0], np.where(both, b[0], np.nan).astype(np.float32))
            difference = np.where(both, np.abs(a[0] - matched), 0)
            rows, columns = (np.nonzero(both.any(axis))[0] for axis in (1, 0))
            part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            filled = (a[0], np.where(both, matched, a[0]))
            pair = [np.clip(image[part], 0, 255).astype(np.uint8) for image in filled]
            flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(pair[0], pair[1], None)
            length = np.linalg.norm(flow, axis=2)[both[part]]
            worst = np.maximum(worst, difference)
            mad = float(difference[both].mean())
            overlaps.append(
                Overlap(self.used[i], self.used[j], float(np.percentile(length, 95)) / scale, mad)
            )
        seen_by = np.sum([mask for _, mask in layers], axis=0)
        mean = np.sum([canvas * mask for canvas, mask in layers], axis=0) / np.maximum(seen_by, 1)
        ghosts = cv2.cvtColor((0.35 * 255 + 0.55 * mean).astype(np.uint8), cv2.COLOR_GRAY2BGR)
        ghosts[seen_by == 0] = 0
        ghosts[cv2.GaussianBlur(worst, (0, 0), 2) > GHOST_GREY] = GHOST
        return np.asarray(ghosts), overlaps


def shrink(image: Array) -> Array:
    """The picture, at most LONGEST_SIDE_PX long."""
    scale = min(1.0, LONGEST_SIDE_PX / max(image.shape[:2]))
    if scale == 1.0:
        return image
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _all(image: Array) -> Array:
    return np.full(image.shape[:2], 255, np.uint8)


def _points(image: Array) -> Features:
    return detect_features(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.zeros(image.shape[:2], bool))


def _why_none(status: int, small: Mapping[str, Array]) -> str:
    points = {name: _points(image) for name, image in small.items()}
    best = max(len(match_features(points[a], points[b])[0]) for a, b in combinations(points, 2))
    if best < FEWEST_MATCHES:
        return f"no two of them share more than {best} points"
    if status == cv2.Stitcher_ERR_CAMERA_PARAMS_ADJUST_FAIL:
        return "no camera that only turns explains them"
    return "they share points, but not as pictures of one turning camera do"


def _why_alone(name: str, used: tuple[str, ...], small: Mapping[str, Array]) -> str:
    own = _points(small[name])
    if len(own.positions) < FEWEST_MATCHES:
        return f"it shows too little to hold on to ({len(own.positions)} points)"
    shared = {other: len(match_features(own, _points(small[other]))[0]) for other in used}
    nearest = max(shared, key=lambda other: shared[other])
    if shared[nearest] < FEWEST_MATCHES:
        return f"it shares {shared[nearest]} points at most with the others (with {nearest})"
    return f"it shares {shared[nearest]} points with {nearest}, but does not fit beside it"
