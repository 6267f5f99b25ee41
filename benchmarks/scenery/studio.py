"""The room named `studio`: what stands still in it, and the pictures on its walls."""

import cv2
import numpy as np

from benchmarks.scenery import bodies, materials
from benchmarks.scenery.materials import (
    WARM,
    Colour,
    bgr,
    letters,
    noise,
    on_paper,
    pigment,
    polygon,
)
from benchmarks.scenery.meshes import Mesh, box, ellipsoid, lathe, panel, rod, sheet
from capture_app.simulation.scenes.definition import Floats, Part, Picture
from capture_app.simulation.scenes.moving_bodies import turn

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


def _gradient(shape: tuple[int, int], top: Colour, bottom: Colour) -> Floats:
    t = np.linspace(0, 1, shape[0], dtype=np.float32)[:, None, None]
    return np.broadcast_to(bgr(top) * (1 - t) + bgr(bottom) * t, (*shape, 3)).copy()


def mountains(rng: np.random.Generator) -> Picture:
    """Travel poster: ranges of hills before an evening sun (420 x 300)."""
    height, width = 420, 300
    poster = _gradient((height, width), (88, 130, 160), (250, 196, 120))
    cv2.circle(poster, (196, 170), 44, pigment((252, 236, 196)), -1, cv2.LINE_AA)
    column = np.arange(width)
    for step, colour in enumerate(
        ((206, 132, 108), (160, 92, 96), (104, 70, 92), (54, 48, 76), (28, 32, 52))
    ):
        ridge = 190 + 40 * step + sum(
            rng.uniform(6, 26) / k * np.sin(column * 0.012 * k + rng.uniform(0, 6.3)) for k in range(1, 7)
        )  # fmt: skip
        outline = np.stack([np.r_[column, width - 1, 0], np.r_[ridge, height, height]], -1)
        polygon(poster, outline, colour)
    for _ in range(46):
        x, base, size = rng.uniform(0, width), rng.uniform(372, 420), rng.uniform(14, 34)
        polygon(poster, [(x - size / 4, base), (x + size / 4, base), (x, base - size)], (16, 22, 34))
    letters(poster, "ALPENGLOW", (150, 44), 27, (250, 240, 220), 2)
    letters(poster, "summer trains 1962", (150, 72), 12, (250, 240, 220), 1)
    return on_paper(rng, poster)


def shapes(rng: np.random.Generator) -> Picture:
    """Exhibition poster of plain shapes (400 x 300)."""
    poster = np.ones((400, 300, 3), np.float32) * bgr((232, 220, 198))
    cv2.circle(poster, (112, 140), 78, pigment(WARM[0]), -1, cv2.LINE_AA)
    cv2.ellipse(poster, (190, 190), (84, 84), 0, -90, 90, pigment(WARM[4]), -1, cv2.LINE_AA)
    cv2.rectangle(poster, (36, 214), (134, 300), pigment(WARM[1]), -1)
    polygon(poster, [(150, 306), (262, 306), (206, 216)], WARM[3])
    for k in range(9):
        cv2.line(poster, (36 + k * 11, 214), (36 + k * 11, 300), pigment(WARM[5]), 2, cv2.LINE_AA)
    for k in range(7):
        cv2.circle(poster, (190, 190), 12 + k * 11, pigment(WARM[5]), 1, cv2.LINE_AA)
    letters(poster, "form + time", (150, 340), 26, (36, 40, 56), 2)
    letters(poster, "twelve evenings of moving pictures", (150, 372), 9, (36, 40, 56), 1)
    return on_paper(rng, poster)


def harbour(rng: np.random.Generator) -> Picture:
    """Painted sea with sailing boats, landscape format (260 x 380)."""
    height, width = 260, 380
    sea = _gradient((height, width), (236, 214, 178), (38, 84, 110))
    sea[120:] = sea[120:] * 0.4 + bgr((40, 104, 128)) * 0.6
    sea += (
        16 * noise(rng, (height, width), (9, 60))[..., None]
        + 9 * noise(rng, (height, width), (4, 18))[..., None]
    )
    for x, base, size in ((84, 176, 80), (236, 196, 108), (320, 150, 44)):
        polygon(sea, [(x, base), (x, base - size), (x + size * 0.5, base)], (246, 238, 222))
        polygon(sea, [(x - 4, base), (x - 4, base - size * 0.85), (x - size * 0.36, base)], WARM[0])
        deck, keel = base + 4, base + size * 0.2
        bow, stern = x + size * 0.55, x - size * 0.42
        hull = [(stern, deck), (bow, deck), (x + size * 0.3, keel), (x - size * 0.28, keel)]
        polygon(sea, hull, (52, 40, 40))
    for _ in range(240):
        start = (int(rng.uniform(0, width)), int(rng.uniform(150, height)))
        end = (start[0] + int(rng.uniform(6, 22)), start[1])
        cv2.line(sea, start, end, pigment((188, 214, 214)), 1, cv2.LINE_AA)
    return on_paper(rng, sea, 0.05)


def words(rng: np.random.Generator) -> Picture:
    """Typographic poster (420 x 300)."""
    poster = np.ones((420, 300, 3), np.float32) * bgr((214, 92, 58))
    for k, (line, size) in enumerate((("MANY", 62), ("EYES", 68), ("ONE", 74), ("BLINK", 54))):
        letters(poster, line, (150, 62 + k * 84), size, (250, 234, 206), 7)
    for k in range(9):
        cv2.circle(poster, (30 + k * 30, 392), 9, pigment((250, 234, 206)), 2 + (k % 3) * 3, cv2.LINE_AA)
    return on_paper(rng, poster)


def city(rng: np.random.Generator) -> Picture:
    """Night skyline with lit windows (300 x 420)."""
    height, width = 300, 420
    night = _gradient((height, width), (28, 34, 66), (178, 96, 96))
    cv2.circle(night, (318, 60), 24, pigment((246, 236, 208)), -1, cv2.LINE_AA)
    left = -10
    while left < width:
        wide, top = int(rng.integers(26, 60)), int(rng.integers(80, 210))
        tone = float(rng.uniform(0.6, 1.3))
        cv2.rectangle(
            night, (left, top), (left + wide, height), pigment((30 * tone, 32 * tone, 52 * tone)), -1
        )
        for y in range(top + 7, height, 11):
            for x in range(left + 5, left + wide - 5, 9):
                if rng.random() < 0.55:
                    glow = rng.uniform(0.5, 1.0)
                    cv2.rectangle(
                        night, (x, y), (x + 4, y + 5), pigment((250 * glow, 206 * glow, 120 * glow)), -1
                    )
        left += wide + int(rng.integers(-6, 6))
    return on_paper(rng, night)


def pictures(rng: np.random.Generator) -> dict[str, Picture]:
    """Textures of the room, by name."""
    boards = materials.planks(rng, (200, 260), (196, 152, 100), width=40, length=200)
    found = {
        "floor": materials.planks(rng, (1500, 1900), (178, 126, 80), width=48, length=520),
        "brick": materials.bricks(rng, (800, 1150), brick=(19, 54)),
        "paper": materials.wallpaper(rng, (900, 1000), (84, 112, 100)),
        "plaster": materials.plain(rng, (600, 700), (222, 208, 184), rough=0.07),
        "skirting": materials.wood(rng, (48, 1200), (232, 224, 208), contrast=0.5),
        "pale_wood": materials.wood(rng, (128, 512), (206, 164, 112)),
        "dark_wood": materials.wood(rng, (128, 512), (96, 62, 42)),
        "shelf_wood": materials.wood(rng, (128, 700), (150, 104, 66)),
        "rug": materials.kilim(rng, (420, 760)),
        "boards": boards,
        "stencil": materials.stencil(rng, boards),
        "leaf": materials.leaf(rng, (160, 64), (62, 112, 58)),
        "leaf_light": materials.leaf(rng, (160, 64), (98, 142, 70)),
        "soil": materials.plain(rng, (64, 64), (66, 48, 36), rough=0.3),
        "pot": materials.plain(rng, (120, 240), (190, 104, 70), rough=0.08),
        "basket": materials.cloth(rng, (120, 260), [(196, 156, 104), (150, 108, 66)], stripe=9, fade=1.6),
        "pouf": materials.cloth(
            rng, (160, 420), [(206, 150, 66), (226, 208, 176), (62, 108, 112)], stripe=15
        ),
        "ball": materials.ball(rng),
        "mountains": mountains(rng),
        "shapes": shapes(rng),
        "harbour": harbour(rng),
        "words": words(rng),
        "city": city(rng),
    }
    for number in range(24):
        found[f"book{number}"] = materials.spine(rng)
    for number, colour in enumerate(materials.WARM):
        found[f"flag{number}"] = materials.cloth(rng, (72, 72), [colour])
    return found


def fixtures(rng: np.random.Generator) -> list[Part]:
    """Everything that stands still, floor and walls first."""
    return [
        Part("floor", [panel((LEFT, FLOOR, FRONT), (0, 0, BACK - FRONT), (RIGHT - LEFT, 0, 0), "floor")]),
        Part("walls", _walls()),
        # Its top alone: of two faces in one plane, the processor's rounding would pick the one in sight.
        Part("rug", [panel((-1.075, FLOOR - 0.01, 2.02), (2.15, 0, 0), (0, 0, 1.2), "rug")]),
        Part("pictures", framed_pictures()),
        Part("bunting", bunting()),
        Part("shelf", shelf(rng)),
        Part("plant", plant(rng)),
        Part("crate", crate()),
        Part("pouf", pouf()),
        Part("ball", ball()),
        Part("stand", bodies.stand()),
    ]


def _walls() -> list[Mesh]:
    high = FLOOR - TOP
    deep = BACK - FRONT
    walls = [
        panel((LEFT, TOP, BACK), (RIGHT - LEFT, 0, 0), (0, high, 0), "brick"),
        panel((LEFT, TOP, FRONT), (0, 0, deep), (0, high, 0), "paper", window=(0, 0, 1.15, 1)),
        panel((RIGHT, TOP, FRONT), (0, 0, deep), (0, high, 0), "paper", window=(0.4, 0, 1.55, 1)),
    ]
    walls += box((0.0, FLOOR - 0.06, BACK - 0.009), (RIGHT - LEFT, 0.12, 0.018), "skirting")
    for x in (LEFT + 0.009, RIGHT - 0.009):
        walls += box((x, FLOOR - 0.06, (FRONT + BACK) / 2), (0.018, 0.12, deep), "skirting")
    return walls
