"""Layers of a pinhole camera's view: static parts, lit once for all frames, and moving parts.

Rows are read one after another, so moving parts and their shadows are cast for each row at its own time.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_app.plugins.cameras.sim.rendering import lighting
from capture_app.plugins.cameras.sim.rendering.lighting import sky_irradiance
from capture_app.plugins.cameras.sim.rendering.raycast import Body, Hits, bundle_rays
from capture_app.plugins.cameras.sim.scenes.moving_bodies import Poses
from capture_app.plugins.cameras.sim.scenes.stages import Floats
from capture_app.session.format.calibration import CameraCalibration

SUBPIXELS = ((-0.25, -0.25), (0.25, 0.25), (0.25, -0.25), (-0.25, 0.25))
"""Offsets of a pixel's four samples from its centre, right and down, in px."""
_NONE = np.zeros((0, 3), np.float32)
_BOUNCE = np.array([0.085, 0.105, 0.125], np.float32)
"""Warm light reflected by whatever hides the sky."""


@dataclass(frozen=True, eq=False)
class View:
    """Pinhole camera: x_cam = rotation x_world + translation in m, centres of pixels at integers."""

    name: str
    width: int
    height: int
    focal_px: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    @property
    def principal_point(self) -> tuple[float, float]:
        """Image point of the optical axis in px: the middle of the image."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    @property
    def centre(self) -> Floats:
        """Position of the camera in the world, in m."""
        return (-self.rotation.T @ self.translation).astype(np.float32)

    def directions(self, right: float = 0.0, down: float = 0.0) -> Floats:
        """Return world directions (H, W, 3) of unit depth through the pixels, offset by part of a pixel."""
        cx, cy = self.principal_point
        x = (np.arange(self.width) + right - cx) / self.focal_px
        y = (np.arange(self.height) + down - cy) / self.focal_px
        grid = np.stack([*np.meshgrid(x, y), np.ones((self.height, self.width))], axis=-1)
        return (grid @ self.rotation).astype(np.float32)

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return image points and depth (N, 3: px, px, m) of world points (N, 3) in m."""
        camera = np.asarray(points, np.float64) @ self.rotation.T + self.translation
        depth = camera[:, 2:]
        return np.hstack([self.focal_px * camera[:, :2] / depth + self.principal_point, depth])

    def calibration(self) -> CameraCalibration:
        """Return this camera as a session's calibration stores it; the rig's frame is the world's."""
        cx, cy = self.principal_point
        right, down, ahead = ((float(a), float(b), float(c)) for a, b, c in self.rotation)
        x, y, z = (float(v) for v in self.translation)
        return CameraCalibration(
            width=self.width, height=self.height, fx=self.focal_px, fy=self.focal_px, cx=cx, cy=cy,
            rotation=(right, down, ahead), translation=(x, y, z),
        )  # fmt: skip


def look_at(name: str, place: ArrayLike, target: ArrayLike, *, scale: float = 1.0) -> View:
    """Return an upright camera of 640x480 px (times `scale`) and 520 px focal length that looks at `target`.

    `place` and `target` are in m.
    """
    centre = np.asarray(place, np.float64)
    ahead = np.asarray(target, np.float64) - centre
    ahead /= np.linalg.norm(ahead)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    width, height = round(640 * scale), round(480 * scale)
    return View(name, width, height, 520.0 * scale, rotation, -rotation @ centre)


@dataclass(frozen=True)
class StillLayer:
    """The still scene, one sample per pixel (H, W), with linear light from sky and from sun separate."""

    directions: Floats
    depth: Floats
    from_sky: Floats
    from_sun: Floats
    sunlit: NDArray[np.intp]
    """Flat indices (N) of the pixels that the sun reaches."""
    on_sun_plane: Floats
    """Places of their points (2, N) across and along the sun's rays, in m."""


def cast_depth(view: View, room: Body, directions: Floats) -> tuple[Floats, NDArray[np.uint8]]:
    """Return depth (H, W) in m and object number (H, W) of the room; 0 where the ray hits nothing."""
    hits = room.cast(bundle_rays(view.centre, directions))
    seen = np.isfinite(hits.distance)
    depth = np.where(seen, hits.distance, 0).astype(np.float32)
    thing = np.where(seen, room.thing[np.where(seen, hits.triangle, 0)], 0).astype(np.uint8)
    return depth.reshape(directions.shape[:2]), thing.reshape(directions.shape[:2])


def still_layer(view: View, room: Body, number: int) -> StillLayer:
    """Return the layer of a view of the room for sample `number` of SUBPIXELS."""
    directions = view.directions(*SUBPIXELS[number])
    rays = bundle_rays(view.centre, directions)
    hits = room.cast(rays)
    colour, normals = room.surface_at(hits, rays[:, 3:], footprint=hits.distance / (2 * view.focal_px))
    points = rays[:, :3] + rays[:, 3:] * hits.distance[:, None] + normals * 0.002
    shape = directions.shape
    from_sun = colour * _sun_light(room, points, normals, number)
    sunlit = np.flatnonzero(from_sun.any(axis=1))
    return StillLayer(
        directions=directions,
        depth=hits.distance.reshape(shape[:2]),
        from_sky=(colour * _sky_light(room, points, normals, number)).reshape(shape),
        from_sun=from_sun.reshape(shape),
        sunlit=sunlit,
        on_sun_plane=lighting.SUN_PLANE @ points[sunlit].T,
    )


def _sky_light(room: Body, points: Floats, normals: Floats, number: int) -> Floats:
    """Return the mean radiance (N, 3) from the sky and from whatever hides it.

    All points of a layer share the directions, which keeps the shade free of noise. The next layer's
    directions fall between them.
    """
    directions = _sphere(16, number / len(SUBPIXELS))
    facing = np.maximum(directions @ normals.T, 0)
    total = facing.sum(axis=0)
    for direction, weights in zip(directions, facing, strict=True):
        lit = np.flatnonzero(weights > 0.02)
        # At most this distance in m, because the room is open to the light.
        weights[lit[room.occludes(bundle_rays(points[lit], direction), near=0.0, far=1.7)]] = 0
    # Radiance of the open directions, and the bounce from all others.
    light = facing.T @ (lighting.sky_radiance(directions) - _BOUNCE) + total[:, None] * _BOUNCE
    return np.asarray(light / np.maximum(total, 1e-3)[:, None], np.float32)


def _sphere(count: int, rotation: float) -> Floats:
    number = np.arange(count) + 0.5
    height = 1 - 2 * ((number + rotation - 0.375) / count)
    radius = np.sqrt(np.maximum(1 - height**2, 0))
    angle = 2 * np.pi * (number * 0.618034 + rotation * 0.618034)
    return np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], -1).astype(np.float32)


def _sun_light(room: Body, points: Floats, normals: Floats, number: int) -> Floats:
    facing = np.maximum(normals @ lighting.TO_SUN, 0) * lighting.window_fraction(points)
    lit = np.flatnonzero(facing > 0)
    open_fraction = np.zeros(len(lit), np.float32)
    for half in (0, 1):
        rays = bundle_rays(points[lit], lighting.sun_direction(2 * number + half, 2 * len(SUBPIXELS)))
        open_fraction += 0.5 * ~room.occludes(rays, near=0.0, far=20.0)
    facing[lit] *= open_fraction
    return np.asarray(facing[:, None] * lighting.SUN, np.float32)


Rectangle = tuple[slice, slice]


@dataclass(frozen=True)
class MovingPart:
    """A rigid body, its poses by row, and the rectangle of the image that contains it."""

    body: Body
    rotation: Floats
    translation: Floats
    rectangle: Rectangle
    shadow: tuple[float, float, float]
    """Centre across and along the sun's rays, and radius, in m, of the region it shades at any row."""


def moving_part(view: View, body: Body, pose: Poses) -> MovingPart:
    """Return a moving body as a camera sees it, with a pose for each row of the view.

    Its rectangle is empty if the body is outside the image.
    """
    rotation, translation = pose.rotation.astype(np.float32), pose.translation.astype(np.float32)
    centres = rotation @ body.centre + translation
    image = view.project(centres)
    radius_px = body.radius * view.focal_px / np.maximum(image[:, 2] - body.radius, 0.1) + 2
    # A row sees the part at its own time only.
    rows = np.flatnonzero(np.abs(np.arange(view.height) - image[:, 1]) < radius_px)
    rectangle = (slice(0), slice(0))
    if len(rows):
        left = max(int(np.min(image[rows, 0] - radius_px[rows])), 0)
        right = min(int(np.max(image[rows, 0] + radius_px[rows])) + 1, view.width)
        rectangle = (slice(rows[0], rows[-1] + 1), slice(left, max(left, right)))
    plane = centres @ lighting.SUN_PLANE.T
    middle = (plane.min(0) + plane.max(0)) / 2
    # The angular size of the sun moves a ray by less than 5 cm across the room.
    radius = body.radius + 0.05 + float(np.ptp(plane, axis=0).max())
    return MovingPart(body, rotation, translation, rectangle, (float(middle[0]), float(middle[1]), radius))


@dataclass(frozen=True)
class VisiblePart:
    """The pixels (flat indices, N) where one part is the nearest object, and the hits of their rays."""

    part: MovingPart
    pixels: NDArray[np.intp]
    rays: Floats
    hits: Hits

    def select(self, chosen: NDArray[np.bool_]) -> "VisiblePart":
        """Return only the pixels for which `chosen` (N) is true."""
        at = np.flatnonzero(chosen)
        return VisiblePart(self.part, self.pixels[at], self.rays[at], self.hits.select(at))


def find_visible(
    view: View, directions: Floats, depth: Floats, parts: Iterable[MovingPart]
) -> list[VisiblePart]:
    """Return each part's visible pixels in front of `depth` (H, W), which is updated in place."""
    layers, front = [], depth.reshape(-1)
    numbers = np.arange(front.size).reshape(depth.shape)
    for part in parts:
        rows, columns = part.rectangle
        if not numbers[rows, columns].size:
            continue
        rotation = part.rotation[rows]
        centre = np.matmul((view.centre - part.translation[rows])[:, None], rotation)
        rays = bundle_rays(centre, np.matmul(directions[rows, columns], rotation))
        seen = VisiblePart(part, numbers[rows, columns].reshape(-1), rays, part.body.cast(rays))
        layers.append(seen.select(seen.hits.distance < front[seen.pixels]))
        front[layers[-1].pixels] = layers[-1].hits.distance
    return [seen.select(seen.hits.distance == front[seen.pixels]) for seen in layers]


def light_changes(
    view: View, still: StillLayer, parts: Sequence[MovingPart], room: Body, to_sun: Floats
) -> tuple[NDArray[np.intp], Floats]:
    """Return the pixels (flat indices, N) that the parts change in a layer, and the light changes (N, 3)."""
    from_sky, from_sun = still.from_sky.reshape(-1, 3), still.from_sun.reshape(-1, 3)
    pixels, colours = [np.zeros(0, np.intp)], [_NONE]
    normals, points = [_NONE], [_NONE]
    for seen in find_visible(view, still.directions, still.depth.copy(), parts):
        if not len(seen.pixels):
            continue
        colour, normal = seen.part.body.surface_at(
            seen.hits, seen.rays[:, 3:], footprint=seen.hits.distance / (2 * view.focal_px)
        )
        rotation = seen.part.rotation[seen.pixels // view.width]
        displacement = still.directions.reshape(-1, 3)[seen.pixels] * seen.hits.distance[:, None]
        pixels.append(seen.pixels)
        colours.append(colour)
        normals.append(np.einsum("nij,nj->ni", rotation, normal))
        points.append(view.centre + displacement)
    in_front = np.concatenate(pixels)
    # All parts at once, because each cast costs more than its rays.
    light = _shade(
        np.concatenate(points), np.concatenate(normals), in_front // view.width, parts, room, to_sun
    )
    shown = np.concatenate(colours) * light - from_sky[in_front] - from_sun[in_front]
    covered = np.zeros(still.depth.size, np.bool_)
    covered[in_front] = True
    near = np.zeros(len(still.sunlit), np.bool_)
    for part in parts:
        near |= _near_shadow(still.on_sun_plane, part)
    lit = still.sunlit[near]
    lit = lit[~covered[lit]]
    behind = view.centre + still.directions.reshape(-1, 3)[lit] * still.depth.reshape(-1)[lit, None]
    dark = lit[in_shadow(behind, lit // view.width, parts, to_sun)]
    return np.concatenate([in_front, dark]), np.concatenate([shown, -from_sun[dark]])


def _shade(
    points: Floats,
    normals: Floats,
    rows: NDArray[np.intp],
    parts: Sequence[MovingPart],
    room: Body,
    to_sun: Floats,
) -> Floats:
    light = sky_irradiance(normals) * 0.9
    facing = np.maximum(normals @ lighting.TO_SUN, 0) * lighting.window_fraction(points)
    lit = np.flatnonzero(facing > 0)
    start = points[lit] + normals[lit] * 0.004
    hidden = room.occludes(bundle_rays(start, to_sun), near=0.0, far=20.0)
    facing[lit[hidden | in_shadow(start, rows[lit], parts, to_sun)]] = 0
    return np.asarray(light + facing[:, None] * lighting.SUN, np.float32)


def in_shadow(
    points: Floats, rows: NDArray[np.intp], parts: Iterable[MovingPart], to_sun: Floats
) -> NDArray[np.bool_]:
    """Return whether a part is between each world point (N, 3) and the sun, at the times of the rows (N)."""
    hidden = np.zeros(len(points), np.bool_)
    on_sun_plane = lighting.SUN_PLANE @ points.T
    for part in parts:
        chosen = np.flatnonzero(_near_shadow(on_sun_plane, part))
        if len(chosen):
            rotation, translation = part.rotation[rows[chosen]], part.translation[rows[chosen]]
            start = np.einsum("ni,nij->nj", points[chosen] - translation, rotation)
            hidden[chosen] |= part.body.occludes(bundle_rays(start, to_sun @ rotation), near=0.008, far=20.0)
    return hidden


def _near_shadow(on_sun_plane: Floats, part: MovingPart) -> NDArray[np.bool_]:
    """Return whether a part may shade each point (2, N: across and along the sun's rays, m) at any row."""
    across, along, radius_m = part.shadow
    return np.asarray((on_sun_plane[0] - across) ** 2 + (on_sun_plane[1] - along) ** 2 < radius_m**2)
