"""What stands in the studio's room: pictures, flags, bookcase, plant, crate, pouf and ball."""

import numpy as np

from capture_app.simulation.scenes.meshes import Mesh, box, ellipsoid, lathe, panel, rod, sheet, turn

FLOOR = 1.0
BACK = 4.3
LEFT, RIGHT = -2.3, 2.3
TOP = -2.2
FRONT = 0.6
"""The room's walls, floor and ceiling, in m."""


def _framed(
    picture: str, centre: tuple[float, float, float], size: tuple[float, float], wood: str
) -> list[Mesh]:
    """A picture on the back wall in a wooden frame."""
    (x, y, z), (w, h) = centre, size
    bar = 0.03
    meshes = [panel((x - w / 2, y - h / 2, z - 0.012), (w, 0, 0), (0, h, 0), picture)]
    for sign in (-1, 1):
        meshes += box((x + sign * (w + bar) / 2, y, z - 0.015), (bar, h + 2 * bar, 0.03), wood)
        meshes += box((x, y + sign * (h + bar) / 2, z - 0.015), (w, bar, 0.03), wood)
    return meshes


def framed_pictures() -> list[Mesh]:
    """The pictures on the back and left walls."""
    meshes = _framed("mountains", (-1.10, -0.52, BACK), (0.58, 0.81), "dark_wood")
    meshes += _framed("harbour", (-0.28, -0.72, BACK), (0.66, 0.45), "pale_wood")
    meshes += _framed("shapes", (0.48, -0.50, BACK), (0.48, 0.64), "dark_wood")
    meshes += _framed("city", (-0.26, -0.12, BACK), (0.50, 0.36), "dark_wood")
    sides = _framed("words", (0, 0, 0), (0.55, 0.77), "pale_wood")
    meshes += [m.moved((LEFT, -0.45, 3.25), turn(1, -np.pi / 2)) for m in sides]
    return meshes


def bunting() -> list[Mesh]:
    """Small flags on a string that sags between the walls."""
    meshes = []
    hem = np.array([0.004, 0.0, 0.0])
    for k in range(23):
        x = -2.1 + 4.2 * (k + 0.5) / 23
        y = -1.32 + 0.26 * (1 - (x / 2.1) ** 2)
        tip = np.array([x, y + 0.17, BACK - 0.10])
        top = np.array([[x - 0.075, y, BACK - 0.09], [x + 0.075, y, BACK - 0.09]])
        middle = (top + tip) / 2 - [0, 0, 0.012]
        meshes.append(sheet([top, middle, [tip - hem, tip + hem]], f"flag{(k * 3) % 7}"))
        step = 4.2 / 23
        ends = [(u, -1.32 + 0.26 * (1 - (u / 2.1) ** 2), BACK - 0.09) for u in (x - step / 2, x + step / 2)]
        meshes.append(rod(ends[0], ends[1], 0.004, "skirting", around=6))
    return meshes


def shelf(rng: np.random.Generator) -> list[Mesh]:
    """A bookcase at the right of the back wall."""
    left, right, top, depth = 0.98, 2.18, -0.86, 0.28
    front = BACK - depth
    z = BACK - depth / 2
    board = 0.028
    meshes = box(
        ((left + right) / 2, (top + FLOOR) / 2, BACK - 0.01), (right - left, FLOOR - top, 0.02), "shelf_wood"
    )
    for x in (left, right):
        meshes += box((x, (top + FLOOR) / 2, z), (board, FLOOR - top, depth), "shelf_wood")
    levels = np.linspace(top, FLOOR - 0.08, 6)
    for y in levels:
        meshes += box(((left + right) / 2, y, z), (right - left, board, depth), "shelf_wood")
    for number, y in enumerate(levels[1:]):
        x = left + 0.03
        gap_at = left + rng.uniform(0.5, 0.8)
        while True:
            width = rng.uniform(0.026, 0.058)
            if x + width > right - 0.03:
                break
            if number in (0, 2, 3) and abs(x - gap_at) < 0.10:
                x += 0.20
                continue
            height, deep = rng.uniform(0.20, 0.30), rng.uniform(0.15, 0.21)
            back = front + 0.02 + deep / 2 + rng.uniform(0, 0.03)
            centre = (x + width / 2, y - board / 2 - height / 2, back)
            meshes += box(centre, (width, height, deep), f"book{rng.integers(0, 24)}")
            x += width + rng.uniform(0.001, 0.004)
    vase = lathe([(0.03, -0.20), (0.024, -0.16), (0.055, -0.09), (0.06, -0.05), (0.04, 0.0)], "pot")
    meshes.append(vase.moved((left + 0.25, top - board / 2, z)))
    meshes += box((right - 0.32, top - 0.09, z), (0.30, 0.15, 0.20), "stencil")
    return meshes


def plant(rng: np.random.Generator) -> list[Mesh]:
    """A rubber plant in a basket, before the left wall."""
    x, z = -1.62, 3.45
    profile = [(0.20, -0.34), (0.22, -0.22), (0.21, -0.08), (0.17, 0.0)]
    meshes = [lathe(profile, "basket", around=36).moved((x, FLOOR, z))]
    meshes.append(lathe([(0.001, -0.31), (0.21, -0.31)], "soil", around=24).moved((x, FLOOR, z)))
    for _ in range(5):
        foot = np.array([x + rng.uniform(-0.07, 0.07), FLOOR - 0.30, z + rng.uniform(-0.07, 0.07)])
        away = rng.uniform(0, 2 * np.pi)
        tip = foot + np.array([0.24 * np.cos(away), -rng.uniform(0.75, 1.15), 0.24 * np.sin(away)])
        meshes.append(rod(foot, tip, 0.010, "dark_wood", around=8))
        for along in np.linspace(0.28, 1.0, 9):
            at = foot + (tip - foot) * along
            length = rng.uniform(0.20, 0.30)
            twist = turn(1, rng.uniform(0, 2 * np.pi)) @ turn(0, rng.uniform(-1.5, -0.3))
            blade = _leaf(length, length * 0.40, rng.choice(["leaf", "leaf", "leaf_light"]))
            meshes.append(blade.moved(at, twist @ turn(2, rng.uniform(-0.3, 0.3))))
    return meshes


def _leaf(length: float, width: float, texture: str) -> Mesh:
    """A drooping leaf that starts at the origin and points up (-y)."""
    v, u = np.meshgrid(np.linspace(0, 1, 9), np.linspace(-1, 1, 5), indexing="ij")
    half = width / 2 * np.sin(np.pi * np.clip(v * 0.97 + 0.02, 0, 1)) ** 0.75
    points = np.stack([u * half, -length * (v + 0.08), -0.5 * length * v**2 + 0.25 * half * np.abs(u)], -1)
    return sheet(points, texture)


def crate() -> list[Mesh]:
    """A fruit crate on the floor with picture books in it, turned a little."""
    meshes = box((0, -0.19, 0), (0.56, 0.36, 0.40), "stencil")
    for x in (-0.26, 0.26):
        for z in (-0.18, 0.18):
            meshes += box((x, -0.19, z), (0.06, 0.38, 0.06), "pale_wood")
    meshes += box((0.03, -0.40, 0.02), (0.30, 0.05, 0.24), "book3", window=(0, 0.2, 1, 0.6))
    meshes += [m.moved(rotation=turn(1, 0.3)) for m in box((0.02, -0.445, 0.0), (0.26, 0.04, 0.20), "book9")]
    return [m.moved((0.42, FLOOR, 3.72), turn(1, 0.25)) for m in meshes]


def pouf() -> list[Mesh]:
    """A round stool of cloth at the right."""
    profile = [
        (0.001, -0.34), (0.18, -0.335), (0.25, -0.30), (0.285, -0.20), (0.28, -0.10), (0.24, -0.01),
        (0.2, 0.0),
    ]  # fmt: skip
    return [lathe(profile, "pouf", around=48).moved((1.32, FLOOR, 3.05))]


def ball() -> list[Mesh]:
    """A beach ball on the floor at the left."""
    twist = turn(2, 0.5) @ turn(0, 0.7)
    return [ellipsoid((0.15, 0.15, 0.15), "ball", around=36).moved((-0.86, FLOOR - 0.15, 3.62), twist)]
