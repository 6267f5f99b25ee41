"""Views of one scene, rotated and zoomed so that a point of it stays in place from camera to camera."""

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, resize_view

MAX_MISS_SHARE = 0.12
"""How far the point may be from where a camera saw it, as a share of the picture's width."""
ZOOMS = np.geomspace(0.6, 1.7, 50)
"""Tried in turn until every picture is filled; beyond, too little of the pictures would be left."""


def triangulate_subject(views: Mapping[str, View], seen: Mapping[str, Array]) -> tuple[Array, float] | None:
    """The point (3,) of the rig's frame nearest to what each camera saw at a pixel (2,), or None.

    Least squares over the distances from the rays (a pixel each). With it how far it is from those pixels at
    most, px. None where fewer than two cameras saw something, or a camera would have the point behind it,
    outside its picture or farther than `MAX_MISS_SHARE` from that pixel.
    """
    matrix, vector = np.zeros((3, 3)), np.zeros(3)
    for name, pixel in seen.items():
        view = views[name]
        ray = view.rays(np.asarray(pixel, float).reshape(1, 2))[0] @ view.rotation
        ray /= np.linalg.norm(ray)
        across = np.eye(3) - np.outer(ray, ray)
        matrix += across
        vector += across @ view.centre
    if len(seen) < 2 or np.linalg.cond(matrix) > 1e8:
        return None
    point = np.linalg.solve(matrix, vector)
    miss = 0.0
    for name, view in views.items():
        found = project_point(view, point)
        if found is None or not (0 <= found[0] < view.width and 0 <= found[1] < view.height):
            return None
        if name in seen:
            away = float(np.linalg.norm(found - seen[name]))
            if away > MAX_MISS_SHARE * view.width:
                return None
            miss = max(miss, away)
    return point, miss


def project_point(view: View, point: Array) -> Array | None:
    """Where a view shows a point of the rig's frame, px (2,); None = behind it."""
    at = view.rotation @ point + view.translation
    if at[2] <= 1e-9:
        return None
    return np.asarray(view.project(at.reshape(1, 3))[0])


def stabilize_views(
    views: Mapping[str, View], point: Array, width: int, height: int
) -> dict[str, View] | None:
    """Undistorted views that all show the point at one place, upright and at one scale, width x height px.

    Each stands where its camera stands and is only turned and zoomed, so that a picture of it needs nothing
    that its camera did not see. The place is where the cameras themselves show the point on average. None
    where no zoom fills them all.
    """
    down = np.mean([view.rotation[1] for view in views.values()], axis=0)
    places = []
    for view in views.values():
        pixel = project_point(view, point)
        assert pixel is not None
        places.append((pixel + 0.5) / (view.width, view.height))
    place = np.mean(places, axis=0) * (width, height) - 0.5
    away = {name: float(np.linalg.norm(point - view.centre)) for name, view in views.items()}
    scale = float(np.median([view.focal / view.width / away[name] for name, view in views.items()])) * width
    turned = {}
    for name, view in views.items():
        ahead = (point - view.centre) / away[name]
        right = np.cross(down, ahead)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(ahead, right), ahead])
        turned[name] = View(
            width, height, np.eye(3), np.zeros(5), rotation, np.asarray(-rotation @ view.centre)
        )
    for zoom in ZOOMS:
        held = {}
        for name, view in turned.items():
            focal = float(zoom) * scale * away[name]
            held[name] = replace(
                view, matrix=np.array([[focal, 0, place[0]], [0, focal, place[1]], [0, 0, 1.0]])
            )
        if all(_filled(held[name], view) for name, view in views.items()):
            return held
    return None


def _filled(held: View, view: View) -> bool:
    """Whether the camera's own picture reaches every edge of the stabilized one."""
    rays = held.rays(held.border(12)) @ held.rotation @ view.rotation.T
    if float(rays[:, 2].min()) < 0.1:
        return False
    x, y = view.project(rays).T
    return bool(
        (x >= 0).all() and (y >= 0).all() and (x <= view.width - 1).all() and (y <= view.height - 1).all()
    )


def render_view(held: View, view: View, image: Array, empty: tuple[int, int, int]) -> Array:
    """A camera's picture as its stabilized view shows it (BGR); what it does not reach is `empty`."""
    shrink = max(1.0, view.focal / held.focal)
    if shrink > 1.5:
        size = round(view.width / shrink), round(view.height / shrink)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        view = resize_view(view, *size)
    turn = held.rotation @ view.rotation.T
    maps = cv2.initUndistortRectifyMap(
        view.matrix, view.distortion, turn, held.matrix, (held.width, held.height), cv2.CV_32FC1
    )
    return np.asarray(
        cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=empty)
    )
