"""Scenes with exact truth for the multi-view benchmark: the package's studio, and plainer ones."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from benchmarks.reconstruction import blank_scenes
from capture_app.plugins.cameras.sim.rendering.scene import Scene, load
from reconstruction.common.geometry import Array, View, look_along
from reconstruction.common.native_libraries import load_open3d

OFFSETS_MS = (66, -33, 0, 33, -66)
PLACES = ((-0.32, 0.03), (-0.16, -0.05), (0.0, 0.0), (0.16, 0.06), (0.32, -0.04))


@dataclass(frozen=True)
class Condition:
    """Images (uint8 BGR), true depth (m, 0 = none) and motion masks by camera."""

    pictures: dict[str, Array]
    depth: dict[str, Array]
    movers: dict[str, Array]


@dataclass(frozen=True)
class Rendered:
    """One instant of a scene: synchronized, and with `OFFSETS_MS` between the cameras."""

    name: str
    views: dict[str, View]
    synced: Condition
    offset: Condition


def studio(width: int = 640, height: int = 480) -> Rendered:
    """Render the package's own scene, five of its views."""
    stage = load("studio", scale=_scale(width, height))
    return _rendered(stage, ("cam05", "cam00", "cam06", "cam01", "cam04"), at_s=1.37)


def blank_room(width: int = 640, height: int = 480) -> Rendered:
    """Render a room with nearly blank walls, a ramp, thin rods and leaves."""
    stage = Scene("blank-room", blank_scenes.ROOM, scale=_scale(width, height))
    return _rendered(stage, tuple(blank_scenes.ROOM_CAMERAS), at_s=0.62)


def blank_attic(width: int = 640, height: int = 480) -> Rendered:
    """Render leaning blank walls, crossing ramps, thin rods and leaves, with cameras farther apart."""
    stage = Scene("blank-attic", blank_scenes.ATTIC, scale=_scale(width, height))
    return _rendered(stage, tuple(blank_scenes.ATTIC_CAMERAS), at_s=0.4)


def _scale(width: int, height: int) -> float:
    if 3 * width != 4 * height:
        raise SystemExit(f"this scene is 4 to 3, not {width}x{height}; --scene plain has any size")
    return width / 640


def _rendered(stage: Scene, names: tuple[str, ...], *, at_s: float) -> Rendered:
    """Render views of a scene at that time, and with `OFFSETS_MS` about it."""
    known = stage.calibration().cameras
    views = {
        name: View.from_calibration(known[name], known[name].width, known[name].height) for name in names
    }

    def shoot(offsets: tuple[int, ...]) -> Condition:
        pictures, depth, movers = {}, {}, {}
        for number, (name, offset_ms) in enumerate(zip(names, offsets, strict=True)):
            start_ns = round(at_s * 1e9) + offset_ms * 1_000_000
            pictures[name] = stage.render(name, start_ns, 4_000_000, 30_000, seed=number)
            depth[name], _, movers[name] = stage.ground_truth(name, start_ns, 4_000_000, 30_000)
        return Condition(pictures, depth, movers)

    size = next(iter(views.values()))
    return Rendered(f"{stage.name} {size.width}x{size.height}", views, shoot((0,) * 5), shoot(OFFSETS_MS))


def plain(width: int = 640, height: int = 480) -> Rendered:
    """Render a scene that nothing was tuned to: weak texture, thin rods, ramp, long floor, flying box."""
    o3d = load_open3d()
    base = View(width, height, _matrix(width, height), np.zeros(5), np.eye(3), np.zeros(3))
    views = {}
    for number, (x, y) in enumerate(PLACES):
        ahead = np.array([0.2 * x, 0.15, 3.2]) - (x, y, 0)
        ahead /= np.linalg.norm(ahead)
        turn = look_along(ahead, np.array([0.0, 1.0, 0.0]))
        views[f"cam{number}"] = replace(base, rotation=turn, translation=-turn @ np.array([x, y, 0]))
    still = _still_things(o3d)

    def shoot(offsets: tuple[int, ...]) -> Condition:
        pictures, depth, movers = {}, {}, {}
        for number, (name, offset_ms) in enumerate(zip(views, offsets, strict=True)):
            at_s = offset_ms / 1000
            things = [*still, *_moving_things(o3d, at_s)]
            rng = np.random.default_rng(number + 31 * offset_ms % 97)
            pictures[name], depth[name], which = shoot_view(o3d, views[name], things, rng)
            movers[name] = which >= len(still)
        return Condition(pictures, depth, movers)

    return Rendered(f"plain {width}x{height}", views, shoot((0,) * 5), shoot(OFFSETS_MS))


def clutter_row(width: int = 640, height: int = 480) -> Rendered:
    """Render random boxes for five parallel cameras in a row, unevenly spaced."""
    return _clutter("clutter-row", 5, [(x, 0.0) for x in (-0.45, -0.3, 0.05, 0.2, 0.4)], (width, height), 1e6)


def clutter_grid(width: int = 640, height: int = 480) -> Rendered:
    """Render random boxes for five cameras in a square and its middle, turned to one point."""
    places = [(-0.25, -0.2), (0.25, -0.15), (0.0, 0.02), (-0.2, 0.2), (0.22, 0.18)]
    return _clutter("clutter-grid", 8, places, (width, height), 3.0)


def _clutter(
    name: str, seed: int, places: list[tuple[float, float]], size: tuple[int, int], looked_at_m: float
) -> Rendered:
    o3d, rng = load_open3d(), np.random.default_rng(seed)
    base = View(*size, _matrix(*size), np.zeros(5), np.eye(3), np.zeros(3))
    views = {}
    for number, (x, y) in enumerate(places):
        turn = cv2.Rodrigues(np.array([-y, x, 0]) / looked_at_m)[0]
        views[f"cam{number}"] = replace(base, rotation=turn, translation=-turn @ np.array([x, y, 0]))
    things = [
        (
            make_box(o3d, np.array([0, 0, 4.6]), (12, 8, 0.1), (0.1, -0.2, 0)),
            make_paint(seed, 14.0, (1, 1, 1)),
        )
    ]
    for number in range(14):
        centre = np.array([*rng.uniform((-1.6, -1.1, 2.2), (1.6, 1.1, 4.0))])
        box = make_box(o3d, centre, tuple(rng.uniform(0.2, 0.9, 3)), tuple(rng.uniform(-0.8, 0.8, 3)))
        things.append(
            (box, make_paint(100 * seed + number, rng.uniform(6, 30), tuple(rng.uniform(0.6, 1.1, 3))))
        )
    pictures, depth, movers = {}, {}, {}
    for camera, view in views.items():
        pictures[camera], depth[camera], which = shoot_view(o3d, view, things, rng)
        movers[camera] = np.zeros(which.shape, bool)
    still = Condition(pictures, depth, movers)
    return Rendered(f"{name} {size[0]}x{size[1]}", views, still, still)


def plain_pair(baseline: float = 0.2) -> tuple[Array, Array, Array, float]:
    """Render two parallel views of the plain scene (uint8 BGR), the left depth (m), and focal x baseline."""
    o3d = load_open3d()
    left = View(640, 480, _matrix(640, 480), np.zeros(5), np.eye(3), np.zeros(3))
    right = replace(left, translation=np.array([-baseline, 0, 0]))
    things = [*_still_things(o3d), *_moving_things(o3d, 0.0)]
    first, depth, _ = shoot_view(o3d, left, things, np.random.default_rng(0))
    second, _, _ = shoot_view(o3d, right, things, np.random.default_rng(1))
    return first, second, depth, left.focal * baseline


def _matrix(width: int, height: int) -> Array:
    focal = 0.8 * width
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])


def make_paint(seed: int, contrast: float, tint: tuple[float, float, float], finest: int = 10) -> Array:
    """Return cloudy noise, float32 1024 x 1024 x 3 around mid-grey times `tint`."""
    rng = np.random.default_rng(seed)
    image = np.zeros((1024, 1024), np.float32)
    for octave in range(3, finest):
        cells = rng.standard_normal((2**octave, 2**octave)).astype(np.float32)
        image += 0.8**octave * cv2.resize(cells, (1024, 1024), interpolation=cv2.INTER_CUBIC)
    image *= contrast / image.std()
    return (120 + image)[..., None] * np.array(tint, np.float32)


def make_box(
    o3d: Any, centre: Array, size: tuple[float, float, float], turn: tuple[float, float, float]
) -> Any:
    """Return a box of a size (m) at a centre, turned by a rotation vector (radians)."""
    mesh = o3d.geometry.TriangleMesh.create_box(*size).translate(-np.array(size) / 2)
    mesh.rotate(cv2.Rodrigues(np.array(turn))[0], center=(0, 0, 0))
    return mesh.translate(centre)


def _still_things(o3d: Any) -> list[tuple[Any, Array]]:
    rods = o3d.geometry.TriangleMesh()
    for x in np.linspace(-0.9, 0.9, 7):
        rods += make_box(o3d, np.array([x, 0.1, 2.7 + 0.1 * x]), (0.025, 1.6, 0.025), (0, 0, 0.1 * x))
    return [
        (
            make_box(o3d, np.array([0, 0, 5.2]), (9, 6, 0.1), (0, 0.12, 0)),
            make_paint(11, 7.0, (0.9, 1.0, 1.1)),
        ),
        (
            make_box(o3d, np.array([0, 1.15, 3.0]), (9, 0.1, 9), (0.02, 0, 0.03)),
            make_paint(12, 22.0, (0.7, 0.9, 1.0)),
        ),
        (
            make_box(o3d, np.array([1.2, 0.7, 3.6]), (1.1, 0.1, 1.6), (0.6, 0.3, 0)),
            make_paint(13, 9.0, (1, 0.8, 0.7)),
        ),
        (
            make_box(o3d, np.array([-1.3, 0.7, 3.4]), (0.7, 0.9, 0.7), (0, 0.5, 0)),
            make_paint(14, 28.0, (0.8, 1.1, 0.8)),
        ),
        (rods, make_paint(15, 30.0, (0.6, 0.6, 1.2))),
    ]


def _moving_things(o3d: Any, at_s: float) -> list[tuple[Any, Array]]:
    place = np.array([0.15 + 1.6 * at_s, -0.1 - 2.2 * at_s + 4.9 * at_s**2, 2.1])
    return [
        (
            make_box(o3d, place, (0.5, 0.45, 0.3), (0.3, 0.4 + 3 * at_s, 0.1)),
            make_paint(16, 26.0, (1, 0.9, 0.9)),
        )
    ]


def shoot_view(
    o3d: Any, view: View, things: list[tuple[Any, Array]], rng: np.random.Generator, noise: float = 1.5
) -> tuple[Array, Array, Array]:
    """Render an image with 2 x 2 samples per pixel, true depth, and the visible object's index.

    `noise` is its standard deviation, grey levels.
    """
    light = np.zeros((view.height, view.width, 3), np.float32)
    for right, down in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
        light += _cast(o3d, view, things, right, down)[0] / 4
    _, depth, which = _cast(o3d, view, things, 0.0, 0.0)
    noisy = light + rng.normal(0, noise, light.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8), depth, which


def _cast(
    o3d: Any, view: View, things: list[tuple[Any, Array]], right: float, down: float
) -> tuple[Array, Array, Array]:
    scene = o3d.t.geometry.RaycastingScene(nthreads=2)
    numbers = [scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh)) for mesh, _ in things]
    pixels = view.grid() + np.array([right, down])
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(view.matrix).T
    world = rays @ view.rotation
    origin = np.broadcast_to(view.centre, world.shape)
    hits = scene.cast_rays(o3d.core.Tensor(np.hstack([origin, world]).astype(np.float32)))
    depth, number = hits["t_hit"].numpy(), hits["geometry_ids"].numpy()
    normal = hits["primitive_normals"].numpy()
    colours = np.zeros((len(world), 3), np.float32)
    which = np.full(len(world), -1)
    for index, (geometry, (mesh, paint)) in enumerate(zip(numbers, things, strict=True)):
        seen = np.flatnonzero(number == geometry)
        if not len(seen):
            continue
        which[seen] = index
        # Texture moves with the object: its coordinates start at the object's centre.
        at = view.centre + world[seen] * depth[seen, None] - mesh.get_center()
        axis = np.abs(normal[seen]).argmax(1)
        a, b = np.where(axis == 0, 1, 0), np.where(axis == 2, 1, 2)
        rows = np.arange(len(seen))
        uv = np.column_stack([at[rows, a], at[rows, b]]) * 260 + 37 * axis[:, None]
        where = np.zeros((-(-len(seen) // 1024) * 1024, 2), np.float32)
        where[: len(seen)] = np.mod(uv, 1023)
        got = cv2.remap(paint, where.reshape(-1, 1024, 2), None, cv2.INTER_LINEAR)
        ray = world[seen] / np.linalg.norm(world[seen], axis=1, keepdims=True)
        shade = 0.5 + 0.5 * np.abs((normal[seen] * ray).sum(1))
        colours[seen] = got.reshape(-1, 3)[: len(seen)] * shade[:, None]
    shape = (view.height, view.width)
    depth = np.where(np.isfinite(depth), depth, 0).astype(np.float32)
    return colours.reshape(*shape, 3), depth.reshape(shape), which.reshape(shape)


SCENES = {
    "studio": studio,
    "plain": plain,
    "blank-room": blank_room,
    "blank-attic": blank_attic,
    "clutter-row": clutter_row,
    "clutter-grid": clutter_grid,
}
