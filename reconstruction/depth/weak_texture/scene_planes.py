"""Planes that many points of a scene lie on, found one after the other."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.calibrated_image import CalibratedImage
from reconstruction.depth.plane_fitting import fit_planes, surface_normals

TOLERANCE = 0.006
"""Points are on a plane if their depth is off by less than this share."""
MIN_SHARE = 0.004
"""Share of a picture that must lie on a plane."""
MAX_PLANES = 32
EVERY = 2
"""Of so many points of a picture one is taken."""
TRIALS, JUDGES = 80, 3000
"""Points whose own planes are tried for the next plane, and points by which these are judged."""
ROUNDS = 4
NORMAL_REACH_PX = 3


class SurfacePoints(NamedTuple):
    """Points of surfaces in the rig's frame, their normals and the cameras that saw them, each (n, 3)."""

    places: Array
    normals: Array
    centres: Array


class ScenePlane(NamedTuple):
    """A plane of the rig's frame: normal . X = distance, in the rig's unit."""

    normal: Array
    distance: float

    def inverse_depth_gradient(self, view: View) -> Array:
        """The vector (3,) whose product with a view's ray (x, y, 1) is the plane's inverse depth there."""
        normal = view.rotation @ self.normal
        away = self.distance + float(normal @ view.translation)
        return np.asarray(normal / (away if abs(away) > 1e-9 else 1e-9), np.float32)

    def off(self, points: SurfacePoints) -> Array:
        """By which share of their depth points are off the plane, along the rays they were seen by (n,)."""
        return np.asarray(_relative_gaps(self.normal[None], np.array([self.distance]), points)[0])


def sample_surface(image: CalibratedImage, inverse_depth: Array, evident: Array) -> SurfacePoints:
    """Points of a view's surface and their normals where it is evident (bool height x width)."""
    usual = float(np.median(inverse_depth))
    known = np.where(evident, inverse_depth, np.float32(-1e6))
    level, right, down = fit_planes(known, 3 * TOLERANCE * usual, reach=NORMAL_REACH_PX, rounds=3)
    facing = surface_normals(level, right, down, image.rays)
    rows, columns = np.nonzero(evident)
    rows, columns = rows[::EVERY], columns[::EVERY]
    pixels = np.column_stack([columns, rows]).astype(float)
    places = image.view.unproject(pixels, 1 / np.maximum(inverse_depth[rows, columns], 1e-9).astype(float))
    normals = facing[rows, columns] @ image.view.rotation
    centres = np.broadcast_to(image.view.centre, places.shape)
    return SurfacePoints(*(part.astype(np.float32) for part in (places, normals, centres)))


def find_scene_planes(samples: Iterable[SurfacePoints], least: int) -> list[ScenePlane]:
    """Planes on which at least so many of all points lie, largest first."""
    left = SurfacePoints(*(np.concatenate(part) for part in zip(*samples, strict=True)))
    found: list[ScenePlane] = []
    while len(found) < MAX_PLANES and len(left.places) >= least:
        plane = _refined(_most_supported(left), left)
        off = plane.off(left)
        if np.count_nonzero(off < TOLERANCE) < least:
            break
        found.append(plane)
        # What lies just beside it would make the same plane again.
        left = _selected(left, off >= 2 * TOLERANCE)
    return found


def _most_supported(points: SurfacePoints) -> ScenePlane:
    tried, judges = (
        _selected(points, slice(None, None, max(1, len(points.places) // n))) for n in (TRIALS, JUDGES)
    )
    distances = (tried.normals * tried.places).sum(1)
    support = (_relative_gaps(tried.normals, distances, judges) < TOLERANCE).sum(1)
    best = int(support.argmax())
    return ScenePlane(tried.normals[best], float(distances[best]))


def _refined(plane: ScenePlane, points: SurfacePoints) -> ScenePlane:
    """The plane by least squares through the points on it, again and again."""
    for _ in range(ROUNDS):
        close = _selected(points, plane.off(points) < TOLERANCE)
        on = SurfacePoints(*(part.astype(float) for part in close))
        if len(on.places) < 3:
            break
        weights = 1 / np.maximum(np.abs(plane.distance - on.centres @ plane.normal), 1e-9) ** 2
        middle = np.average(on.places, axis=0, weights=weights)
        spread = on.places - middle
        normal = np.linalg.eigh((spread * weights[:, None]).T @ spread)[1][:, 0]
        plane = ScenePlane(normal, float(normal @ middle))
    return plane


def _relative_gaps(normals: Array, distances: Array, points: SurfacePoints) -> Array:
    """Gaps (planes x points) along the rays between planes and points, over the points' planes' depth."""
    normals, distances = normals.astype(np.float32), distances.astype(np.float32)[:, None]
    gaps = np.abs(normals @ points.places.T - distances)
    return np.asarray(gaps / np.maximum(np.abs(normals @ points.centres.T - distances), 1e-9))


def _selected(points: SurfacePoints, chosen: Array | slice) -> SurfacePoints:
    return SurfacePoints(*(part[chosen] for part in points))
