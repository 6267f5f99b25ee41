"""Drawn rooms with exact truth: a seed draws what is in a room, its paints, cameras, their size and noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from benchmarks.reconstruction.multiview_scenes import Condition, Rendered, make_box, make_paint, shoot_view
from reconstruction.common.geometry import Array, View, look_along
from reconstruction.common.native_libraries import load_open3d

SUBJECT_M = 3.0
"""Distance of the cameras from the middle of the room's contents."""
SPACING_DEG = 1.0, 10.0
"""Angle between neighbouring cameras, seen from the subject."""
MAX_PARALLEL_DEG = 25.0
"""Largest angle between the outer cameras that may look in parallel; others look at the subject."""
SIZES = {320: 8, 480: 8, 640: 6, 960: 4, 1280: 3}
"""Widths of the images, px, and the largest number of cameras of each."""
SIZE_ODDS = 0.6, 0.2, 0.16, 0.02, 0.02
Thing = tuple[Any, Array]


@dataclass(frozen=True)
class Draw:
    """What a kind of room is drawn with: random numbers, Open3D and some paints."""

    rng: np.random.Generator
    o3d: Any
    paints: list[Array]

    def paint(self) -> Array:
        """Return one of the paints."""
        return self.paints[self.rng.integers(len(self.paints))]

    def place(self) -> Array:
        """Return a place (x, y, z) around the subject, m."""
        return self.rng.uniform((-1.5, -1.0, 2.1), (1.5, 1.0, 4.0))

    def box(self, centre: Any, size: Any, tilt: float) -> Any:
        """Return a box, turned by up to `tilt` radians about each axis."""
        return make_box(self.o3d, np.asarray(centre), tuple(size), tuple(self.rng.uniform(-tilt, tilt, 3)))


def boxes(draw: Draw) -> list[Thing]:
    """Boxes of all sizes, everywhere."""
    count = draw.rng.integers(5, 25)
    return [(draw.box(draw.place(), draw.rng.uniform(0.1, 0.9, 3), 0.8), draw.paint()) for _ in range(count)]


def posts(draw: Draw) -> list[Thing]:
    """Thin posts, nearly upright, and a few boxes."""
    rng = draw.rng
    thin = [
        (draw.box(draw.place(), (width, rng.uniform(0.8, 2.2), width), 0.2), draw.paint())
        for width in rng.uniform(0.02, 0.1, rng.integers(6, 14))
    ]
    return [*thin, *boxes(draw)[:4]]


def slopes(draw: Draw) -> list[Thing]:
    """Large slabs, steeply inclined."""
    size = 1.6, 0.06, 1.6
    return [(draw.box(draw.place(), size, 1.2), draw.paint()) for _ in range(draw.rng.integers(3, 7))]


def balls(draw: Draw) -> list[Thing]:
    """Balls of all sizes."""
    sphere = draw.o3d.geometry.TriangleMesh.create_sphere
    radii = draw.rng.uniform(0.1, 0.5, draw.rng.integers(5, 13))
    return [(sphere(r, 40).translate(draw.place()), draw.paint()) for r in radii]


def blank(draw: Draw) -> list[Thing]:
    """Boxes with almost no texture, as of walls, and a few others."""
    pale = [120 + 0.12 * (paint - 120) for paint in draw.paints]
    fewer = replace(draw, paints=[*pale, draw.paints[0]])
    return boxes(fewer)


def tiles(draw: Draw) -> list[Thing]:
    """Boxes whose paint repeats itself every 10 to 40 cm, not quite."""
    period = int(draw.rng.integers(26, 104))
    times = -(-1024 // period)
    tiled = [
        np.tile(paint[:period, :period], (times, times, 1))[:1024, :1024] + 0.15 * (draw.paints[0] - 120)
        for paint in draw.paints
    ]
    return boxes(replace(draw, paints=tiled))


def leaves(draw: Draw) -> list[Thing]:
    """Foliage: small flat pieces in bushes."""
    found = []
    for _ in range(draw.rng.integers(3, 7)):
        bush, middle = draw.o3d.geometry.TriangleMesh(), draw.place()
        for _ in range(draw.rng.integers(20, 60)):
            size = *draw.rng.uniform(0.04, 0.2, 2), 0.004
            bush += draw.box(middle + draw.rng.normal(0, 0.25, 3), size, 1.5)
        found.append((bush, draw.paint()))
    return found


def figures(draw: Draw) -> list[Thing]:
    """Figures with limbs, of cylinders and a ball."""
    mesh, found = draw.o3d.geometry.TriangleMesh, []
    for _ in range(draw.rng.integers(1, 5)):
        middle = draw.place() * (1, 0.3, 1)
        parts = [((0.0, 0.05, 0.0), 0.18, 0.6), ((-0.1, 0.6, 0.0), 0.07, 0.7), ((0.12, 0.6, 0.0), 0.07, 0.7)]
        parts += [((-0.27, 0.0, -0.1), 0.05, 0.6), ((0.27, 0.0, 0.05), 0.05, 0.6)]
        for at, radius, length in parts:
            limb = mesh.create_cylinder(radius, length, 30)
            turn = cv2.Rodrigues(np.array([np.pi / 2, 0, 0]) + draw.rng.uniform(-0.3, 0.3, 3))[0]
            found.append((limb.rotate(turn, center=(0, 0, 0)).translate(middle + at), draw.paint()))
        found.append((mesh.create_sphere(0.12, 30).translate(middle - (0, 0.42, 0)), draw.paint()))
    return found


def shelves(draw: Draw) -> list[Thing]:
    """A rack of boards with books, whose backs are of one colour each."""
    rng, found = draw.rng, list[Thing]()
    back = rng.uniform(2.8, 4.0)
    for y in np.linspace(-0.9, 0.9, int(rng.integers(3, 6))):
        found.append((draw.box((0, y, back), (3.2, 0.04, 0.4), 0.02), draw.paint()))
        books, x = [draw.o3d.geometry.TriangleMesh() for _ in range(3)], -1.5
        while x < 1.5:
            width, height = rng.uniform(0.03, 0.12), rng.uniform(0.15, 0.32)
            deep = back + rng.uniform(-0.1, 0.1)
            books[rng.integers(3)] += draw.box((x, y - 0.02 - height / 2, deep), (width, height, 0.25), 0.04)
            x += width * rng.uniform(1.0, 1.6)
        found += [(few, draw.paint()) for few in books if len(few.vertices)]
    return found


FITTED: dict[str, Callable[[Draw], list[Thing]]] = {
    kind.__name__: kind for kind in (boxes, posts, balls, blank, leaves, shelves)
}
KEPT_OUT: dict[str, Callable[[Draw], list[Thing]]] = {
    kind.__name__: kind for kind in (slopes, tiles, figures)
}
"""Kinds of rooms to which confidence is fitted, and those that only judge it."""
KINDS = FITTED | KEPT_OUT


def draw_room(kind: str, seed: int) -> Rendered:
    """Draw a room of this kind, seen by two to eight cameras."""
    rng = np.random.default_rng([seed, *map(ord, kind)])
    o3d = load_open3d()
    width = int(rng.choice([*SIZES], p=SIZE_ODDS))
    count = int(rng.integers(2, SIZES[width] + 1))
    views = _views(rng, width, count)
    contrast, finest = np.exp(rng.uniform(np.log(3), np.log(30))), int(rng.integers(8, 11))
    paints = [
        make_paint(
            int(rng.integers(1 << 30)),
            contrast * rng.uniform(0.5, 1.5),
            tuple(rng.uniform(0.6, 1.1, 3)),
            finest,
        )
        for _ in range(6)
    ]
    draw = Draw(rng, o3d, paints)
    things = KINDS[kind](draw)
    # Walls and floors are painted like something that stands in the room.
    wall, floor = (things[k][1] for k in rng.integers(len(things), size=2))
    things.append((draw.box((0, 0, rng.uniform(4.2, 5.5)), (16, 10, 0.1), 0.25), wall))
    if rng.random() < 0.6:
        things.append((draw.box((0, 1.25, 3), (12, 0.1, 9), 0.04), floor))
    noise, uneven = rng.uniform(0.7, 4), rng.uniform(0, 0.1)
    pictures, depth, movers = {}, {}, {}
    for camera, view in views.items():
        shown, depth[camera], which = shoot_view(o3d, view, things, rng, noise)
        pictures[camera] = cv2.convertScaleAbs(shown, alpha=1 + rng.uniform(-uneven, uneven))
        movers[camera] = np.zeros(which.shape, bool)
    still = Condition(pictures, depth, movers)
    return Rendered(f"{kind} {seed}, {width} px", views, still, still)


def _views(rng: np.random.Generator, width: int, count: int) -> dict[str, View]:
    """Draw cameras in a row, an arc or two rows."""
    height, focal = width * 3 // 4, width * rng.uniform(0.65, 1.1)
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    base = View(width, height, matrix, np.zeros(5), np.eye(3), np.zeros(3))
    spacing = np.radians(np.exp(rng.uniform(*np.log(SPACING_DEG))))
    rows = 2 if count > 3 and rng.random() < 0.4 else 1
    places = np.array([(k // rows, k % rows) for k in range(count)], float)
    angles = spacing * (places - places.mean(0) + rng.normal(0, 0.12, places.shape))
    parallel = np.degrees(np.ptp(angles[:, 0])) < MAX_PARALLEL_DEG and rng.random() < 0.4
    subject, views = np.array([0, 0, SUBJECT_M]), {}
    for number, (across, up) in enumerate(angles):
        ahead = np.array([np.sin(across), np.sin(up), np.cos(across) * np.cos(up)])
        centre = subject - SUBJECT_M * ahead
        if parallel:
            centre[2], ahead = 0, np.array([0, 0, 1.0])
        turn = look_along(ahead / np.linalg.norm(ahead), np.array([0.0, 1.0, 0.0]))
        views[f"cam{number}"] = replace(base, rotation=turn, translation=-turn @ centre)
    return views
