"""Points from which a scene's reconstruction starts: matched between cameras, or scattered in their views."""

from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Any

import numpy as np

from capture_app.session.exporting.descriptor_matches import match_descriptors
from capture_app.session.exporting.point_cloud import PointCloud
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import (
    Array,
    Picture,
    centre_of,
    lens_of,
    matrix_of,
    picture_rays,
    rays_of,
    rotation_of,
    translation_of,
    triangulate_rays,
)

_MAX_FEATURES = 4000
_NEIGHBOURS = 4
"""Number of nearest cameras with which each camera is matched."""
_DISTINCT = 0.85
"""Maximum ratio of the distances to the best and the second best match (Lowe 2004)."""
_MAX_ERROR_PX = 1.5
_MIN_ANGLE = 0.005
"""Minimum angle between the rays of a point, radians."""
_CELL_PX = 12
_HIDDEN = 1.03
"""Depth beyond which a point is hidden, relative to the nearest point of its cell of `_CELL_PX` px."""


def match_points(cameras: Mapping[str, CameraCalibration], pictures: Mapping[str, Picture]) -> PointCloud:
    """Return points that at least two cameras see, by SIFT matches that agree with the calibration.

    The cameras are pinholes; their pictures are BGR and show one instant.
    """
    seen = {name: _features(picture) for name, picture in pictures.items()}
    points, colours = [np.zeros((0, 3))], [np.zeros((0, 3), np.uint8)]
    for first, second in _pairs(cameras):
        matches = match_descriptors(seen[first][1], seen[second][1], _DISTINCT)
        pixels = [seen[name][0][own] for name, own in zip((first, second), matches, strict=True)]
        placed, good = _triangulate(cameras[first], cameras[second], *pixels)
        columns, rows = np.rint(pixels[0][good]).astype(int).T
        points.append(placed[good])
        colours.append(pictures[first][rows, columns, ::-1])
    return PointCloud(np.concatenate(points), np.concatenate(colours))


def scatter_points(
    cameras: Mapping[str, CameraCalibration], bounds: Mapping[str, tuple[float, float]], number: int
) -> PointCloud:
    """Return grey points, uniform in the cameras' views between near and far, for scenes without points."""
    random = np.random.default_rng(0)
    per_camera = -(-number // len(cameras))
    points = []
    for name, camera in cameras.items():
        near, far = bounds[name]
        depth = (random.uniform(near**3, far**3, per_camera)) ** (1 / 3)
        rays = rays_of(camera, random.uniform(0, [camera.width - 1, camera.height - 1], (per_camera, 2)))
        local = np.column_stack([rays, np.ones(per_camera)]) * depth[:, None]
        points.append((local - translation_of(camera)) @ rotation_of(camera))
    every = np.concatenate(points)
    return PointCloud(every, np.full(every.shape, 128, np.uint8))


def visible_pixels(lens: CameraCalibration, points: Array) -> Array:
    """Return the pixels (n, 2) of points (n, 3) in a camera, NaN where it does not see them."""
    x, y, z = (points @ rotation_of(lens).T + translation_of(lens)).T
    with np.errstate(all="ignore"):
        rays = np.stack([x, y], axis=1) / np.where(z > 0, z, np.nan)[:, None]
        edge = picture_rays(lens)
        pixels = lens_of(lens).project(rays)
        # Beyond its field of view a lens polynomial may turn back into the picture.
        inside = ((rays >= edge.min(0)) & (rays <= edge.max(0))).all(1)
        inside &= ((pixels >= -0.5) & (pixels < (lens.width - 0.5, lens.height - 0.5))).all(1)
    columns, rows = (np.where(inside[:, None], pixels + 0.5, 0) // _CELL_PX).astype(int).T
    nearest = np.full((lens.height // _CELL_PX + 1, lens.width // _CELL_PX + 1), np.inf)
    np.minimum.at(nearest, (rows[inside], columns[inside]), z[inside])
    inside &= z <= _HIDDEN * nearest[rows, columns]
    return np.where(inside[:, None], pixels, np.nan)


def _pairs(cameras: Mapping[str, CameraCalibration]) -> Iterator[tuple[str, str]]:
    """Yield each camera with its nearest ones, every pair once."""
    centres = {name: centre_of(camera) for name, camera in cameras.items()}

    def near(name: str) -> list[str]:
        others = sorted(centres, key=lambda one: float(np.linalg.norm(centres[one] - centres[name])))
        return [other for other in others if other != name][:_NEIGHBOURS]

    neighbours = {name: near(name) for name in cameras}
    for first, second in combinations(cameras, 2):
        if second in neighbours[first] or first in neighbours[second]:
            yield first, second


def _features(picture: Picture) -> tuple[Array, Any]:
    """Return the pixels (n, 2) of SIFT features and their descriptors (n, 128), float32 of unit length."""
    import cv2

    detector = cv2.SIFT.create(_MAX_FEATURES, contrastThreshold=0.01)
    keypoints, found = detector.detectAndCompute(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), None)
    pixels = np.array([point.pt for point in keypoints], np.float64).reshape(-1, 2)
    descriptors = np.asarray(found if found is not None else np.zeros((0, 128)), np.float32)
    # Hellinger distance (Arandjelovic and Zisserman 2012): the root of the descriptor's parts.
    return pixels, np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))


def _triangulate(first: CameraCalibration, second: CameraCalibration, *pixels: Array) -> tuple[Array, Any]:
    """Return points (n, 3) of matched pixels of two pinholes, and which of them both cameras may see (n)."""
    cameras = (first, second)
    poses = [np.column_stack([rotation_of(camera), translation_of(camera)]) for camera in cameras]
    rays = [
        (seen - matrix_of(camera)[:2, 2]) / [camera.fx, camera.fy]
        for camera, seen in zip(cameras, pixels, strict=True)
    ]
    homogeneous = triangulate_rays(zip(rays, poses, strict=True))
    with np.errstate(all="ignore"):
        points = homogeneous[:, :3] / homogeneous[:, 3:]
        good = np.isfinite(points).all(axis=1)
        for one, pose, seen in zip(cameras, poses, pixels, strict=True):
            local = points @ pose[:, :3].T + pose[:, 3]
            error = local[:, :2] / local[:, 2:] * [one.fx, one.fy] + matrix_of(one)[:2, 2] - seen
            good &= (local[:, 2] > 0) & (np.linalg.norm(error, axis=1) < _MAX_ERROR_PX)
        a, b = (points - centre_of(camera) for camera in cameras)
        sine = np.linalg.norm(np.cross(a, b), axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    return points, good & (sine > _MIN_ANGLE)
