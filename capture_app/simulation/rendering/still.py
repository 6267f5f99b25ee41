"""What a camera sees of everything that stands still: cast and lit once, kept for all frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_app.simulation.rendering import lighting
from capture_app.simulation.rendering.raycast import Body, bundle_rays
from capture_app.simulation.rendering.view import View
from capture_app.simulation.scenes.meshes import Floats

SUBPIXELS = ((-0.25, -0.25), (0.25, 0.25), (0.25, -0.25), (-0.25, 0.25))
"""Where in a pixel its four samples lie: right and down of the centre, in px."""

_SKY_RAYS = 16
_SKY_REACH_M = 1.7
"""Things farther off cast no shade on each other: the room is open to the light."""
_BOUNCE = np.array([0.085, 0.105, 0.125], np.float32)
"""Light, warm, that comes back from whatever hides the sky."""


@dataclass(frozen=True)
class StillLayer:
    """One sample of each pixel (H, W): linear light from the sky and from the sun kept apart."""

    directions: Floats
    depth: Floats
    from_sky: Floats
    from_sun: Floats
    sunlit: NDArray[np.intp]
    """Flat indices of the pixels that the sun reaches."""


def still_layers(view: View, room: Body, samples: int = len(SUBPIXELS)) -> list[StillLayer]:
    """The layers of a view of the room, one for each of so many samples of a pixel."""
    return [_layer(view, room, number) for number in range(samples)]


def cast_depth(view: View, room: Body, directions: Floats) -> tuple[Floats, NDArray[np.uint8]]:
    """Depth (H, W) in m and thing (H, W) of the room; 0 where there is none."""
    hits = room.cast(bundle_rays(view.centre, directions))
    seen = np.isfinite(hits.distance)
    depth = np.where(seen, hits.distance, 0).astype(np.float32)
    thing = np.where(seen, room.thing[np.where(seen, hits.triangle, 0)], 0).astype(np.uint8)
    return depth.reshape(directions.shape[:2]), thing.reshape(directions.shape[:2])


def _layer(view: View, room: Body, number: int) -> StillLayer:
    directions = view.directions(*SUBPIXELS[number])
    rays = bundle_rays(view.centre, directions)
    hits = room.cast(rays)
    footprint = hits.distance / (2 * view.focal_px)
    colour, normals = room.surface_at(hits, rays[:, 3:], footprint)
    points = rays[:, :3] + rays[:, 3:] * hits.distance[:, None] + normals * 0.002
    shape = directions.shape
    from_sun = colour * _sun_light(room, points, normals, number)
    return StillLayer(
        directions=directions,
        depth=hits.distance.reshape(shape[:2]),
        from_sky=(colour * _sky_light(room, points, normals, number)).reshape(shape),
        from_sun=from_sun.reshape(shape),
        sunlit=np.flatnonzero(from_sun.any(axis=1)),
    )


def _sky_light(room: Body, points: Floats, normals: Floats, number: int) -> Floats:
    """Mean radiance (N, 3) from the sky and from what hides it.

    All points of a layer share the directions, so that shade is free of noise; the next layer's lie
    between them.
    """
    directions = _sphere(_SKY_RAYS, number / len(SUBPIXELS))
    facing = np.maximum(directions @ normals.T, 0)
    total = facing.sum(axis=0)
    for direction, share in zip(directions, facing, strict=True):
        lit = np.flatnonzero(share > 0.02)
        rays = bundle_rays(points[lit], direction)
        share[lit[room.occludes(rays, near=0.0, far=_SKY_REACH_M)]] = 0
    # Radiance of the directions that are open, and the bounce from all the others.
    light = facing.T @ (lighting.sky_radiance(directions) - _BOUNCE) + total[:, None] * _BOUNCE
    return np.asarray(light / np.maximum(total, 1e-3)[:, None], np.float32)


def _sphere(count: int, turn: float) -> Floats:
    number = np.arange(count) + 0.5
    height = 1 - 2 * ((number + turn - 0.375) / count)
    radius = np.sqrt(np.maximum(1 - height**2, 0))
    angle = 2 * np.pi * (number * 0.618034 + turn * 0.618034)
    return np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], -1).astype(np.float32)


def _sun_light(room: Body, points: Floats, normals: Floats, number: int) -> Floats:
    facing = np.maximum(normals @ lighting.TO_SUN, 0) * lighting.window_share(points)
    lit = np.flatnonzero(facing > 0)
    open_share = np.zeros(len(lit), np.float32)
    for half in (0, 1):
        rays = bundle_rays(points[lit], lighting.sun_direction(2 * number + half, 2 * len(SUBPIXELS)))
        open_share += 0.5 * ~room.occludes(rays, near=0.0, far=20.0)
    facing[lit] *= open_share
    return np.asarray(facing[:, None] * lighting.SUN, np.float32)
