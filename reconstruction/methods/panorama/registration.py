"""Registration of a panorama's images: cameras that only rotate, estimated from the still scene.

Brown and Lowe, Automatic Panoramic Image Stitching using Invariant Features, 2007, by OpenCV's estimators
(`cv2.detail`). Points that do not fit all images together are rejected in addition: clouds, ice or people can
fit a homography between two images.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, angle_deg, resize_view
from reconstruction.common.joined_names import joined_to
from reconstruction.common.memory import memory_budget
from reconstruction.methods.panorama.composition import Layer, Projection, compose_layers
from reconstruction.scene.calibration.consistency import consistent_matches
from reconstruction.scene.pairs import MIN_MATCHES, Features, detect_features, match_features

MAX_SIDE_PX = 2000
"""Image size limit; panoramas of full camera images take minutes."""
BYTES_PER_PIXEL = 70
"""Memory per image pixel: maps and layer, both doubled during blending, and the canvas."""
ROUNDS = 3
"""Readjustments of the cameras without the points that do not fit all images together."""
OUTLIER = 2.0
"""Outlier limit in medians of the residuals; outliers are also off by more than one pixel."""
FOCAL_LIMITS = (0.25, 30.0)
"""Plausible focal lengths as multiples of the image's longer side; others are failed estimates."""
GOOD_PX = 2.0
"""Residual below which no other focal length is tried."""
UPRIGHT = 0.7
"""Minimum cosine between rows of a camera and of the mean of all for a column of upright views."""
LEVEL_DEG = 3.0
"""Minimum angle between cameras from which the vertical direction can be estimated."""
EXPECTED_MATCHES = (8.0, 0.2)
"""Two images overlap if more matches fit than this number plus this fraction of all.

Brown and Lowe, eq. 13, use a fraction of 0.3. It is lower here because a rig's cameras stand apart, and one
plane of the scene covers less of all that they share.
"""
INLIER_PX = 3.0


@dataclass(frozen=True)
class PictureOverlap:
    """Still points that two images share, and which of them one homography explains."""

    at: tuple[Array, Array]
    """Undistorted pixels (n, 2) in both images."""
    fits: Array
    """Whether the homography explains each point, bool (n,)."""
    homography: Array
    """Homography, 3x3, from the first to the second image; pixels relative to the image centres."""

    @property
    def confidence(self) -> float:
        """Confidence of the overlap; above 1 both images show the same place."""
        min_matches, fraction = EXPECTED_MATCHES
        inliers = int(self.fits.sum())
        return inliers / (min_matches + fraction * len(self.fits)) if inliers >= MIN_MATCHES else 0.0


def estimate_cameras(
    views: Mapping[str, View], overlaps: Mapping[tuple[str, str], PictureOverlap], calibrated: bool
) -> dict[str, View]:
    """Estimate views with a camera-from-panorama `rotation` and no translation.

    Focal lengths are also estimated if the views are not `calibrated`.

    Raises:
        ValueError: no estimate explains the images.
    """
    used = {
        pair: overlap
        for pair, overlap in overlaps.items()
        if overlap.confidence > 1 and views.keys() >= set(pair)
    }
    turned = _adjust_by_rounds(views, used, calibrated)
    if not calibrated and (turned is None or _residual_px(turned, used) > GOOD_PX):
        longest = max(max(view.width, view.height) for view in views.values())
        # In longer sides; purely shifted images look like long ones.
        trials = (
            {name: _plain_view(view.width, view.height, lengths * longest) for name, view in views.items()}
            for lengths in (1.0, 4.0, 20.0)
        )
        tried = [turned, *(_adjust_by_rounds(trial, used, True) for trial in trials)]
        turned = min(filter(None, tried), key=lambda one: _residual_px(one, used), default=None)
    if turned is None:
        raise ValueError("no camera that only rotates explains the pictures")
    return _level(turned)


def _plain_view(width: int, height: int, focal: float) -> View:
    """Return an uncalibrated view with a given focal length, px, and without distortion."""
    matrix = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return View(width, height, matrix, np.zeros(5), np.eye(3), np.zeros(3))


def _adjust_by_rounds(
    views: Mapping[str, View], overlaps: Mapping[tuple[str, str], PictureOverlap], held: bool
) -> dict[str, View] | None:
    """Adjust the cameras, repeatedly without outliers; None on failure. `held` fixes the intrinsics."""
    turned = _adjust(views, overlaps, held)
    for _ in range(ROUNDS):
        if turned is None:
            return None
        fitting = {
            (a, b): _without_outliers(overlap, turned[a], turned[b]) for (a, b), overlap in overlaps.items()
        }
        turned = _adjust(views, fitting, held)
    return turned


def _residual_px(views: Mapping[str, View], overlaps: Mapping[tuple[str, str], PictureOverlap]) -> float:
    """Return the residual of the points, px: the mean over the overlaps of their medians."""
    return float(
        np.mean(
            [
                np.median(_off(overlap, views[a], views[b])[overlap.fits])
                for (a, b), overlap in overlaps.items()
            ]
        )
    )


def _level(views: Mapping[str, View]) -> dict[str, View]:
    """Rotate all views together so that the panorama is level."""
    rotations: Sequence[Any] = [np.ascontiguousarray(view.rotation.T, np.float32) for view in views.values()]
    first, *others = views.values()
    # The nearest rotation to their mean: a camera that looks at the middle, as upright as they are.
    left, _, right = np.linalg.svd(np.sum(rotations, axis=0))
    by_mean = [(left @ right).T @ rotation for rotation in rotations]
    across, down, _ = np.ptp([rotation[:, 2] for rotation in by_mean], axis=0)
    if down > across and min(rotation[0, 0] for rotation in by_mean) > UPRIGHT:
        # OpenCV lays a column on its side.
        rotations = by_mean
    elif max(angle_deg(first.axis, other.axis) for other in others) > LEVEL_DEG:
        rotations = cv2.detail.waveCorrect(rotations, cv2.detail.WAVE_CORRECT_AUTO)
    return {
        name: replace(view, rotation=np.asarray(rotation, np.float64).T)
        for (name, view), rotation in zip(views.items(), rotations, strict=True)
    }


def _adjust(
    views: Mapping[str, View], overlaps: Mapping[tuple[str, str], PictureOverlap], held: bool
) -> dict[str, View] | None:
    features, matches = _for_opencv(list(views), list(views.values()), overlaps)
    ok, cameras = cv2.detail.HomographyBasedEstimator(held).apply(
        features, matches, [_camera(view) for view in views.values()]
    )
    for camera in cameras:
        camera.R = np.asarray(camera.R, np.float32)
    if ok and _plausible(cameras, views):
        adjuster = cv2.detail.BundleAdjusterReproj() if held else cv2.detail.BundleAdjusterRay()
        adjuster.setConfThresh(0.0)
        if held:
            adjuster.setRefinementMask(np.zeros((3, 3), np.uint8))
        ok, cameras = adjuster.apply(features, matches, cameras)
    if not ok or not _plausible(cameras, views):
        return None
    return {
        name: replace(
            view,
            matrix=np.asarray(camera.K(), np.float64),
            rotation=np.asarray(camera.R, np.float64).T,
            translation=np.zeros(3),
        )
        for (name, view), camera in zip(views.items(), cameras, strict=True)
    }


def _without_outliers(overlap: PictureOverlap, a: View, b: View) -> PictureOverlap:
    """Return the overlap restricted to the points that fit these views."""
    off = _off(overlap, a, b)
    fits = overlap.fits & (off <= max(1.0, OUTLIER * float(np.median(off[overlap.fits]))))
    return replace(overlap, fits=fits) if fits.sum() >= MIN_MATCHES else overlap


def _off(overlap: PictureOverlap, a: View, b: View) -> Array:
    """Return the residuals of points (n,) in the second image by these views, px."""
    rays = np.column_stack([overlap.at[0], np.ones(len(overlap.fits))]) @ np.linalg.inv(a.matrix).T
    seen = rays @ a.rotation @ b.rotation.T @ b.matrix.T
    depth = np.where(np.abs(seen[:, 2:]) < 1e-9, 1e-9, seen[:, 2:])
    return np.asarray(np.linalg.norm(seen[:, :2] / depth - overlap.at[1], axis=1))


def _camera(view: View) -> Any:
    camera = cv2.detail.CameraParams()
    camera.focal, camera.aspect = view.matrix[0, 0], view.matrix[1, 1] / view.matrix[0, 0]
    camera.ppx, camera.ppy = view.matrix[:2, 2]
    camera.R = np.eye(3)
    return camera


def _plausible(cameras: Sequence[Any], views: Mapping[str, View]) -> bool:
    return all(
        np.isfinite(camera.R).all()
        and FOCAL_LIMITS[0] < camera.focal / max(view.width, view.height) < FOCAL_LIMITS[1]
        for camera, view in zip(cameras, views.values(), strict=True)
    )


def _for_opencv(
    names: Sequence[str], views: Sequence[View], overlaps: Mapping[tuple[str, str], PictureOverlap]
) -> tuple[list[Any], list[Any]]:
    """Return each image's features and all pairwise matches, in both directions, for `cv2.detail`."""
    count = len(names)
    keypoints: list[list[Any]] = [[] for _ in names]
    matches = [cv2.detail.MatchesInfo() for _ in range(count**2)]
    for (a, b), overlap in overlaps.items():
        i, j = names.index(a), names.index(b)
        begin = len(keypoints[i]), len(keypoints[j])
        for which, at in zip((i, j), overlap.at, strict=True):
            keypoints[which] += [cv2.KeyPoint(float(x), float(y), 1.0) for x, y in at]
        for one, other, homography, (own, target) in (
            (i, j, overlap.homography, begin),
            (j, i, np.linalg.inv(overlap.homography), begin[::-1]),
        ):
            info = matches[one * count + other]
            info.src_img_idx, info.dst_img_idx = one, other
            info.matches = [cv2.DMatch(own + k, target + k, 0.0) for k in range(len(overlap.fits))]
            info.inliers_mask = overlap.fits.astype(np.uint8)
            info.num_inliers, info.confidence = int(overlap.fits.sum()), max(overlap.confidence, 1.0)
            info.H = homography
    features = [cv2.detail.ImageFeatures() for _ in names]
    for index, (feature, view) in enumerate(zip(features, views, strict=True)):
        feature.img_idx, feature.img_size = index, (view.width, view.height)
        feature.keypoints = keypoints[index]
    return features, matches


def register_pictures(
    points: Mapping[str, Features], sizes: Mapping[str, tuple[int, int]], known: Mapping[str, View]
) -> tuple[dict[str, View], dict[str, str]]:
    """Register images of these sizes (width, height) by their still points.

    Returns each camera's view with intrinsics and camera-from-panorama `rotation`, without translation, and
    the reasons why others are left out. `known` are calibrated views of these sizes. If all images have one,
    focal length and distortion are taken from there; else focal length is estimated and distortion is none.

    Raises:
        ValueError: no two images belong together, or no purely rotating camera explains them.
    """
    calibrated = all(name in known for name in points)
    views = {
        name: known[name] if calibrated else _plain_view(*sizes[name], max(sizes[name])) for name in points
    }
    flat = {name: replace(p, positions=views[name].undistort(p.positions)) for name, p in points.items()}
    overlaps = {
        (a, b): _find_overlap(match_features(flat[a], flat[b]), views[a], views[b])
        for a, b in combinations(points, 2)
    }
    if len(used := _largest_group(list(points), overlaps)) < 2:
        raise ValueError(_why_apart(views, overlaps))
    left_out = {name: _reason_left_out(name, points[name], overlaps) for name in points if name not in used}
    return estimate_cameras({name: views[name] for name in used}, overlaps, calibrated), left_out


def _why_apart(views: Mapping[str, View], overlaps: Mapping[tuple[str, str], PictureOverlap]) -> str:
    """Return why no two images belong together."""
    max_shared = max((len(overlap.fits) for overlap in overlaps.values()), default=0)
    if max_shared < MIN_MATCHES:
        return f"no two pictures share more than {max_shared} points"
    pairs = (((views[a].undistorted, views[b].undistorted), *one.at) for (a, b), one in overlaps.items())
    if all(consistent_matches(*pair) is None for pair in pairs):
        return "no two pictures show the same things"
    return "the pictures were taken from places too far apart for a camera that only rotates"


def _find_overlap(at: tuple[Array, Array], a: View, b: View) -> PictureOverlap:
    if len(at[0]) >= MIN_MATCHES:
        centred_a, centred_b = (
            (pixels - (view.width / 2, view.height / 2)).reshape(-1, 1, 2)
            for pixels, view in zip(at, (a, b), strict=True)
        )
        homography_found, fits = cv2.findHomography(
            centred_a, centred_b, cv2.USAC_MAGSAC, INLIER_PX, maxIters=5000, confidence=0.999
        )
        if homography_found is not None and abs(np.linalg.det(homography_found)) >= 1e-9:
            return PictureOverlap(at, np.asarray(fits).ravel() > 0, np.asarray(homography_found))
    return PictureOverlap(at, np.zeros(len(at[0]), bool), np.eye(3))


def _largest_group(names: Sequence[str], overlaps: Mapping[tuple[str, str], PictureOverlap]) -> list[str]:
    """Return the largest group of images connected by overlaps."""
    joined = [pair for pair, overlap in overlaps.items() if overlap.confidence > 1]
    support = {pair: int(one.fits.sum()) for pair, one in overlaps.items()}
    best = max(
        (joined_to(name, joined) for name in names),
        key=lambda members: (len(members), sum(support[pair] for pair in support if members >= set(pair))),
    )
    return [name for name in names if name in best]


def _reason_left_out(name: str, own: Features, overlaps: Mapping[tuple[str, str], PictureOverlap]) -> str:
    if len(own.positions) < MIN_MATCHES:
        return f"it has too few features ({len(own.positions)})"
    own_overlaps = {a if b == name else b: overlap for (a, b), overlap in overlaps.items() if name in (a, b)}
    # An overlap with an image that is used would have made them one group.
    if beside := [other for other, overlap in own_overlaps.items() if overlap.confidence > 1]:
        return f"it belongs to another panorama, with {' and '.join(beside)}: stitch those by themselves"
    nearest = max(own_overlaps, key=lambda other: len(own_overlaps[other].fits))
    shared = len(own_overlaps[nearest].fits)
    if shared < MIN_MATCHES:
        return f"it shares at most {shared} points with another picture ({nearest})"
    return f"it shares {shared} points with {nearest}, but does not fit beside it"


class PanoramaStitcher:
    """Images registered by the still scene; `used` are included, `left_out` holds reasons for the others.

    The methods take images of the same cameras, of this or another condition.
    """

    def __init__(self, views: Mapping[str, View], left_out: Mapping[str, str]) -> None:
        """`views` are those of the included images, as `register_images` finds them."""
        self.views, self.left_out = views, left_out
        self.used, self.projection = tuple(views), Projection(views)

    def layers(self, images: Mapping[str, Array]) -> dict[str, Layer]:
        """Warp the used ones of the BGR images onto the panorama."""
        small = {name: _shrink(images[name], view.width, view.height) for name, view in self.views.items()}
        return {name: self.projection.warp(name, image) for name, image in small.items()}

    def layer_mask(self, name: str, mask: Array) -> Array:
        """Warp a mask (bool) of a camera's image onto the panorama, at its layer's size."""
        return self.projection.warp_mask(
            name, _shrink_mask(mask, self.views[name].width, self.views[name].height)
        )

    def compose(self, layers: Mapping[str, Layer]) -> Array:
        """Compose all layers into the panorama (BGR); its size depends on the registration alone."""
        return compose_layers(list(layers.values()), self.projection.canvas)


def register_images(
    images: Mapping[str, Array],
    moving: Mapping[str, Array] | None = None,
    known: Mapping[str, View] | None = None,
) -> PanoramaStitcher:
    """Register BGR images by features outside of their `moving` (bool); `known` are calibrated views.

    Raises:
        ValueError: the images cannot be stitched.
    """
    if len(images) < 2:
        raise ValueError("a panorama takes two pictures or more")
    sizes = _fit_sizes({name: image.shape[1::-1] for name, image in images.items()})
    views = {name: resize_view(view, *sizes[name]) for name, view in (known or {}).items()}
    points = {
        name: detect_features(cv2.cvtColor(_shrink(image, *sizes[name]), cv2.COLOR_BGR2GRAY))
        for name, image in images.items()
    }
    if moving:
        points = {
            name: own_points.at_rest(_shrink_mask(moving[name], *sizes[name]))
            for name, own_points in points.items()
        }
    return PanoramaStitcher(*register_pictures(points, sizes, views))


def _fit_sizes(sizes: Mapping[str, tuple[int, ...]]) -> dict[str, tuple[int, int]]:
    limited = {name: np.array(size) * min(1.0, MAX_SIDE_PX / max(size)) for name, size in sizes.items()}
    pixels = sum(float(np.prod(size)) for size in limited.values())
    scale = memory_budget().fit_scale(
        f"the panorama of {len(sizes)} pictures", lambda smaller: pixels * smaller**2 * BYTES_PER_PIXEL
    )
    return {
        name: (max(1, round(float(width * scale))), max(1, round(float(height * scale))))
        for name, (width, height) in limited.items()
    }


def _shrink(image: Array, width: int, height: int) -> Array:
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))


def _shrink_mask(mask: Array, width: int, height: int) -> Array:
    small = cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(small > 0)
