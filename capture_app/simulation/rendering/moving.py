"""The moving parts in a camera's picture, each row at its own time, and the shadows they throw."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_app.simulation.rendering import lighting
from capture_app.simulation.rendering.lighting import OpenSky
from capture_app.simulation.rendering.raycast import Body, Hits, bundle_rays
from capture_app.simulation.rendering.still import StillLayer
from capture_app.simulation.rendering.view import View
from capture_app.simulation.scenes.meshes import Floats
from capture_app.simulation.scenes.poses import Poses

Rectangle = tuple[slice, slice]


@dataclass(frozen=True)
class MovingPart:
    """A rigid body, its poses by row and the part of the picture that holds it."""

    body: Body
    rotation: Floats
    translation: Floats
    rectangle: Rectangle
    shadow: tuple[float, float, float]
    """Middle across and along the sun's rays and radius of what it shades, in m, at any row."""

    def to_part_frame(self, points: Floats, rows: NDArray[np.intp]) -> Floats:
        """World points (N, 3) at the times of the rows (N), in the part's frame."""
        turned = np.matmul((points - self.translation[rows])[:, None], self.rotation[rows])
        return np.asarray(turned[:, 0], np.float32)


def moving_parts(view: View, bodies: Mapping[str, Body], poses: Mapping[str, Poses]) -> dict[str, MovingPart]:
    """Parts with poses for each row of the view, by name; those outside the picture have no rectangle."""
    return {name: _moving_part(view, bodies[name], pose) for name, pose in poses.items()}


def _moving_part(view: View, body: Body, pose: Poses) -> MovingPart:
    rotation, translation = pose.rotation.astype(np.float32), pose.translation.astype(np.float32)
    centres = rotation @ body.centre + translation
    image = view.project(centres)
    reach = body.radius * view.focal_px / np.maximum(image[:, 2] - body.radius, 0.1) + 2
    # A row sees the part at that row's time only.
    rows = np.flatnonzero(np.abs(np.arange(view.height) - image[:, 1]) < reach)
    rectangle = (slice(0), slice(0))
    if len(rows):
        left = max(int(np.min(image[rows, 0] - reach[rows])), 0)
        right = min(int(np.max(image[rows, 0] + reach[rows])) + 1, view.width)
        rectangle = (slice(rows[0], rows[-1] + 1), slice(left, max(left, right)))
    plane = centres @ lighting.SUN_PLANE.T
    middle = (plane.min(0) + plane.max(0)) / 2
    # The sun's spread moves a ray by less than 5 cm on its way through the room.
    radius = body.radius + 0.05 + float(np.ptp(plane, axis=0).max())
    return MovingPart(body, rotation, translation, rectangle, (float(middle[0]), float(middle[1]), radius))


@dataclass(frozen=True)
class VisiblePart:
    """The pixels (flat indices, N) where one part is the nearest thing, and what the rays met there."""

    part: MovingPart
    pixels: NDArray[np.intp]
    rays: Floats
    hits: Hits


def find_visible(
    view: View, directions: Floats, depth: Floats, parts: Iterable[MovingPart]
) -> list[VisiblePart]:
    """What each part shows of itself in front of `depth` (H, W), which is brought up to date in place."""
    found = []
    width = view.width
    for part in parts:
        rows, columns = part.rectangle
        count = (rows.stop - rows.start, columns.stop - columns.start)
        if 0 in count:
            continue
        turn = part.rotation[rows]
        centre = np.matmul((view.centre - part.translation[rows])[:, None], turn)
        rays = bundle_rays(centre, np.matmul(directions[rows, columns], turn))
        hits = part.body.cast(rays)
        closer = np.flatnonzero(hits.distance < depth[rows, columns].reshape(-1))
        row, column = np.divmod(closer, count[1])
        pixels = (row + rows.start) * width + column + columns.start
        depth.reshape(-1)[pixels] = hits.distance[closer]
        found.append(VisiblePart(part, pixels, rays[closer], hits.select(closer)))
    front = depth.reshape(-1)
    kept = []
    for seen in found:
        won = np.flatnonzero(seen.hits.distance == front[seen.pixels])
        kept.append(VisiblePart(seen.part, seen.pixels[won], seen.rays[won], seen.hits.select(won)))
    return kept


def light_changes(
    view: View, still: StillLayer, parts: Sequence[MovingPart], room: Body, sky: OpenSky, to_sun: Floats
) -> tuple[NDArray[np.intp], Floats]:
    """Pixels (flat indices, N) that the parts change in a layer, and by how much light (N, 3)."""
    depth = still.depth.copy()
    changed, change = [], []
    from_sky, from_sun = still.from_sky.reshape(-1, 3), still.from_sun.reshape(-1, 3)
    covered = np.zeros(depth.size, np.bool_)
    for seen in find_visible(view, still.directions, depth, parts):
        if not len(seen.pixels):
            continue
        rows = seen.pixels // view.width
        footprint = seen.hits.distance / (2 * view.focal_px)
        colour, normals = seen.part.body.surface_at(seen.hits, seen.rays[:, 3:], footprint)
        normals = np.matmul(seen.part.rotation[rows], normals[:, :, None])[:, :, 0]
        away = still.directions.reshape(-1, 3)[seen.pixels] * seen.hits.distance[:, None]
        light = _shade(view.centre + away, normals, rows, parts, room, sky, to_sun)
        changed.append(seen.pixels)
        change.append(colour * light - from_sky[seen.pixels] - from_sun[seen.pixels])
        covered[seen.pixels] = True
    lit = still.sunlit[~covered[still.sunlit]]
    points = view.centre + still.directions.reshape(-1, 3)[lit] * still.depth.reshape(-1)[lit, None]
    dark = lit[in_shadow(points, lit // view.width, parts, to_sun)]
    changed.append(dark)
    change.append(-from_sun[dark])
    return np.concatenate(changed), np.concatenate(change)


def _shade(
    points: Floats,
    normals: Floats,
    rows: NDArray[np.intp],
    parts: Sequence[MovingPart],
    room: Body,
    sky: OpenSky,
    to_sun: Floats,
) -> Floats:
    light = sky.irradiance(normals) * 0.9
    facing = np.maximum(normals @ lighting.TO_SUN, 0) * lighting.window_share(points)
    lit = np.flatnonzero(facing > 0)
    start = points[lit] + normals[lit] * 0.004
    hidden = room.occludes(bundle_rays(start, to_sun), near=0.0, far=20.0)
    facing[lit[hidden | in_shadow(start, rows[lit], parts, to_sun)]] = 0
    return np.asarray(light + facing[:, None] * lighting.SUN, np.float32)


def in_shadow(
    points: Floats, rows: NDArray[np.intp], parts: Iterable[MovingPart], to_sun: Floats
) -> NDArray[np.bool_]:
    """Whether a part is between each world point (N, 3) and the sun, at the times of the rows (N)."""
    hidden = np.zeros(len(points), np.bool_)
    across, along = lighting.SUN_PLANE @ points.T
    for part in parts:
        middle_across, middle_along, reach = part.shadow
        chosen = np.flatnonzero((across - middle_across) ** 2 + (along - middle_along) ** 2 < reach**2)
        if len(chosen):
            start = part.to_part_frame(points[chosen], rows[chosen])
            rays = bundle_rays(start, to_sun @ part.rotation[rows[chosen]])
            hidden[chosen] |= part.body.occludes(rays, near=0.008, far=20.0)
    return hidden
