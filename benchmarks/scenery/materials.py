"""Procedural materials (wood, brick, cloth, leaves) and prints (book spines, a face): sRGB, BGR, uint8."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_app.simulation.scenes.definition import Floats, Picture

Reals = NDArray[np.floating[Any]]
Colour = tuple[float, float, float]
"""sRGB as red, green, blue in 0 to 255, as designers write it."""


def bgr(colour: Colour) -> Floats:
    """Return the colour in OpenCV's order, for float pictures of 0 to 255."""
    return np.array(colour[::-1], np.float32)


def noise(rng: np.random.Generator, shape: tuple[int, int], cell: tuple[float, float]) -> Floats:
    """Smooth noise of mean 0 and deviation 1, `cell`: height and width in texels of its features."""
    height, width = shape
    rows, columns = max(int(height / cell[0]), 2), max(int(width / cell[1]), 2)
    coarse = rng.standard_normal((rows, columns), dtype=np.float32)
    grown = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(grown / max(float(grown.std()), 1e-6), np.float32)


def fractal(rng: np.random.Generator, shape: tuple[int, int], largest: float, octaves: int) -> Floats:
    """Sum of noises, each of half the size and 0.65 of the strength of the one before; deviation 1."""
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        cell = largest / 2**octave
        total += 0.65**octave * noise(rng, shape, (cell, cell))
    return np.asarray(total / max(float(total.std()), 1e-6), np.float32)


def finish(picture: Reals) -> Picture:
    """Clip to 0 to 255 and round."""
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def plain(
    rng: np.random.Generator, shape: tuple[int, int], colour: Colour, *, rough: float = 0.05
) -> Picture:
    """One colour with blotches and grain; `rough`: the deviation over the colour."""
    shade = 1 + rough * (0.6 * fractal(rng, shape, 40, 4) + 0.8 * noise(rng, shape, (1.5, 1.5)))
    return finish(shade[..., None] * bgr(colour))


def wood(
    rng: np.random.Generator, shape: tuple[int, int], colour: Colour, *, contrast: float = 1.0
) -> Picture:
    """Grain that runs along the width of the picture."""
    height, width = shape
    warp = noise(rng, shape, (height / 2.5, width / 2.5)) * 1.3 + noise(rng, shape, (14, 160)) * 0.25
    rows = np.linspace(0.0, height / 16.0, height, dtype=np.float32)[:, None]
    rings = np.sin(2 * np.pi * (rows + warp)) * 0.5 + 0.5
    fibre = noise(rng, shape, (1.6, 70)) * 0.045 + noise(rng, shape, (5, 240)) * 0.05
    pores = (noise(rng, shape, (1.3, 14)) > 1.9).astype(np.float32) * -0.16
    shade = 1 + contrast * (fibre + pores - 0.13 * rings**2.5)
    darker = np.array([0.86, 0.94, 1.0], np.float32)  # the late wood is redder
    tone = bgr(colour) * (1 - (rings[..., None] ** 2.5) * (1 - darker) * contrast)
    return finish(shade[..., None] * tone)


def planks(
    rng: np.random.Generator, shape: tuple[int, int], colour: Colour, *, width: int, length: int
) -> Picture:
    """Floor boards along the width of the picture, `width` and `length` of a board in texels."""
    grain = wood(rng, (8 * width, 3 * length), colour).astype(np.float32)
    floor = np.zeros((*shape, 3), np.float32)
    for top in range(0, shape[0], width):
        left = -int(rng.integers(0, length))
        while left < shape[1]:
            right = left + int(length * rng.uniform(0.75, 1.25))
            y, x = int(rng.integers(0, 7 * width)), int(rng.integers(0, int(1.7 * length)))
            a, b = max(left, 0), max(min(right, shape[1]), 0)
            board = floor[top : top + width, a:b]
            tint = rng.uniform(0.80, 1.12) * (1 + rng.normal(0, 0.025, 3))
            board[:] = grain[y : y + board.shape[0], x : x + b - a] * tint
            board[-2:] *= 0.38
            board[:1] *= 1.10
            board[:, -2:] *= 0.45
            left = right
    return finish(floor)


def bricks(rng: np.random.Generator, shape: tuple[int, int], *, brick: tuple[int, int]) -> Picture:
    """Old brick wall in running bond; `brick`: height and width of a brick and its joint, in texels."""
    high, wide = brick
    bend = noise(rng, shape, (60, 60)) * 0.9
    y = np.arange(shape[0], dtype=np.float32)[:, None] + bend
    row = np.floor(y / high).astype(np.int32)
    x = np.arange(shape[1], dtype=np.float32)[None] + (row % 2) * wide / 2 + noise(rng, shape, (60, 60)) * 0.9
    column = np.floor(x / wide).astype(np.int32)
    number = (row * 131 + column * 17) % 997
    to_edge = np.minimum(
        np.minimum(y % high, high - y % high), np.minimum(x % wide, wide - x % wide)
    ) + 0.8 * noise(rng, shape, (4, 4))
    inside = np.clip((to_edge - 2.0) / 1.8, 0, 1)
    clays = ((186, 118, 90), (168, 102, 78), (198, 136, 106), (158, 108, 90), (194, 146, 116))
    palette = np.stack([bgr(clay) for clay in clays])
    tint = palette[rng.integers(0, len(palette), 997)] * rng.normal(1.0, 0.08, (997, 1))
    rough = 0.05 * fractal(rng, shape, 24, 4) + 0.055 * noise(rng, shape, (2, 2))
    pits = (noise(rng, shape, (2.6, 2.6)) > 2.05) * -0.20
    face = tint[number] * (1 + rough + pits)[..., None]
    mortar = (
        bgr((200, 184, 164))
        * (1 + 0.06 * noise(rng, shape, (2, 2)) + 0.04 * fractal(rng, shape, 30, 3))[..., None]
    )
    wall = face * inside[..., None] + mortar * (1 - inside[..., None])
    relief = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 1.2)
    light = np.gradient(relief, axis=0) + 0.6 * np.gradient(relief, axis=1)
    return finish(wall * (1 + 0.55 * light[..., None]))


def wallpaper(rng: np.random.Generator, shape: tuple[int, int], colour: Colour) -> Picture:
    """Painted sprigs of leaves, tone on tone, scattered without repeats."""
    paper = np.ones((*shape, 3), np.float32) * bgr(colour)
    for _ in range(int(shape[0] * shape[1] / 5200)):
        x, y = rng.uniform(0, shape[1]), rng.uniform(0, shape[0])
        heading, size = rng.uniform(0, 2 * np.pi), rng.uniform(18, 40)
        tone = bgr(colour) * rng.uniform(0.72, 1.30) + rng.normal(0, 5, 3)
        ink = [float(c) for c in np.clip(tone, 0, 255)]
        for step in range(5):
            for side in (-1, 1):
                at = np.array([x, y]) + np.array([np.cos(heading), np.sin(heading)]) * size * 0.45 * step
                turn = heading + side * (0.9 - 0.08 * step)
                length = size * (0.42 - 0.05 * step)
                centre = at + np.array([np.cos(turn), np.sin(turn)]) * length
                cv2.ellipse(
                    paper, (int(centre[0]), int(centre[1])), (int(length) + 1, int(length * 0.36) + 1),
                    float(np.degrees(turn)), 0, 360, ink, -1, cv2.LINE_AA,
                )  # fmt: skip
    grain = 1 + 0.035 * noise(rng, shape, (1.6, 1.6)) + 0.03 * fractal(rng, shape, 60, 4)
    return finish(paper * grain[..., None])


def cloth(
    rng: np.random.Generator,
    shape: tuple[int, int],
    colours: Sequence[Colour],
    *,
    stripe: int = 0,
    fade: float = 1.0,
) -> Picture:
    """Knitted cloth, in stripes of `stripe` texels down the picture, or plain in the first colour."""
    rows = np.arange(shape[0])[:, None] + (1.2 * noise(rng, shape, (30, 30))).astype(np.int32)
    chosen = (rows // stripe) % len(colours) if stripe else np.zeros_like(rows)
    base = np.stack([bgr(c) for c in colours])[np.broadcast_to(chosen, shape)]
    thread = 0.05 * noise(rng, shape, (2.0, 3.5)) + 0.06 * noise(rng, shape, (3.5, 2.0))
    folds = 0.06 * noise(rng, shape, (30, 16)) + 0.06 * fractal(rng, shape, 18, 3)
    flecks = 0.14 * (noise(rng, shape, (2.5, 3.0)) > 1.6) - 0.12 * (noise(rng, shape, (2.5, 2.5)) > 1.7)
    return finish(base * (1 + fade * (thread + folds + flecks))[..., None])


def denim(rng: np.random.Generator, shape: tuple[int, int]) -> Picture:
    """Washed blue twill with seams at the sides and pale wear in the middle."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    twill = (
        0.05 * np.sin((x + y) * 1.9) + 0.09 * noise(rng, shape, (5, 1.6)) + 0.07 * noise(rng, shape, (2, 2))
    )
    wear = 0.16 * fractal(rng, shape, 30, 4) + 0.18 * np.exp(-(((x / shape[1] - 0.5) / 0.16) ** 2))
    jeans = bgr((66, 94, 138)) * (1 + twill + wear)[..., None]
    for seam in (0.25, 0.75):
        distance = np.abs(x / shape[1] - seam) * shape[1]
        jeans[distance < 1.2] *= 0.62
        stitch = (np.abs(distance - 3.0) < 0.8) & (np.sin(y * 1.3) > -0.2)
        jeans[stitch] = bgr((206, 150, 84))
    return finish(jeans)


def leaf(rng: np.random.Generator, shape: tuple[int, int], colour: Colour) -> Picture:
    """A leaf's face: a pale midrib down the picture with veins to both sides."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    off = np.abs(x - shape[1] / 2)
    veins = np.exp(-((((y + off * 0.8) % 22) - 11) ** 2) / 3.0) * 0.16
    rib = np.exp(-(off**2) / 6.0) * 0.45
    shade = 1 + veins + rib + 0.12 * fractal(rng, shape, 24, 4) + 0.06 * noise(rng, shape, (2, 2))
    return finish(bgr(colour) * shade[..., None])


def hair(rng: np.random.Generator, shape: tuple[int, int], colour: Colour) -> Picture:
    """Strands that run down the picture."""
    strands = (
        0.16 * noise(rng, shape, (40, 1.8))
        + 0.14 * noise(rng, shape, (60, 5))
        + 0.06 * noise(rng, shape, (2, 2))
    )
    return finish(bgr(colour) * (1 + strands)[..., None])


def kilim(rng: np.random.Generator, shape: tuple[int, int]) -> Picture:
    """A woven rug: borders of zigzags around a field of diamonds."""
    height, width = shape
    red, cream, navy, ochre, teal = (
        bgr(c) for c in ((158, 52, 44), (226, 208, 176), (38, 48, 78), (206, 146, 62), (62, 112, 108))
    )
    rug = np.ones((height, width, 3), np.float32) * red
    y, x = np.mgrid[:height, :width].astype(np.float32)
    edge = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    along = np.where(np.minimum(x, width - 1 - x) < np.minimum(y, height - 1 - y), y, x)
    cell = height / 5.0
    u, v = (x / cell + 0.5) % 1 - 0.5, (y / cell) % 1 - 0.5
    diamond = np.abs(u) + np.abs(v)
    index = (np.floor(x / cell + 0.5) * 3 + np.floor(y / cell) * 5).astype(np.int32) % 3
    inks = np.stack([navy, teal, ochre])[index]
    rug[diamond < 0.46] = cream
    rug[diamond < 0.40] = inks[diamond < 0.40]
    rug[diamond < 0.22] = red
    rug[diamond < 0.13] = cream
    band = height * 0.11
    zigzag = np.abs((along / (band * 0.5)) % 1 - 0.5) * band * 0.8 + band * 0.3
    rug[edge < band] = navy
    rug[(edge < band) & (edge < zigzag)] = ochre
    rug[(edge < band) & (edge < zigzag - band * 0.22)] = red
    rug[edge < band * 0.14] = cream
    rug[np.abs(edge - band) < 2.5] = cream
    weave = 0.09 * noise(rng, shape, (1.6, 5)) + 0.07 * fractal(rng, shape, 40, 4)
    return finish(rug * (1 + weave)[..., None])


WARM: tuple[Colour, ...] = (
    (196, 68, 54),
    (226, 148, 60),
    (240, 208, 120),
    (64, 118, 128),
    (44, 62, 96),
    (226, 214, 190),
    (120, 148, 92),
)
"""Colours of the room's paper and cloth."""


def pigment(colour: Colour) -> list[float]:
    """Return the colour as OpenCV draws it."""
    return [float(c) for c in colour[::-1]]


def polygon(picture: Floats, corners: ArrayLike, colour: Colour) -> None:
    """Fill the polygon of the corners (N, 2: x, y in px), in place."""
    cv2.fillPoly(picture, [np.asarray(corners).astype(np.int32)], pigment(colour), cv2.LINE_AA)


def on_paper(rng: np.random.Generator, picture: Reals, strength: float = 0.035) -> Picture:
    """Return the picture with the grain of paper, `strength` being its deviation."""
    shape = (picture.shape[0], picture.shape[1])
    rough = strength * (noise(rng, shape, (1.7, 1.7)) + 0.8 * fractal(rng, shape, 30, 4))
    return finish(picture * (1 + rough)[..., None])


def letters(
    picture: Floats,
    text: str,
    centre: tuple[float, float],
    height: float,
    colour: Colour,
    weight: float = 2.0,
) -> None:
    """Print `text` into the picture about `centre` (x, y), letters of `height` px, in place."""
    font, scale = cv2.FONT_HERSHEY_DUPLEX, height / 22.0
    (width, tall), _ = cv2.getTextSize(text, font, scale, max(int(weight), 1))
    at = (int(centre[0] - width / 2), int(centre[1] + tall / 2))
    mask = np.zeros(picture.shape[:2], np.uint8)
    cv2.putText(mask, text, at, font, scale, 255, max(int(weight), 1), cv2.LINE_AA)
    cover = mask[..., None].astype(np.float32) / 255
    picture[:] = picture * (1 - cover) + bgr(colour) * cover


def spine(rng: np.random.Generator) -> Picture:
    """A book's back, title running down it (256 x 48)."""
    colour = WARM[int(rng.integers(0, len(WARM)))]
    back = np.ones((48, 256, 3), np.float32) * bgr(colour) * float(rng.uniform(0.65, 1.1))
    pale = sum(colour) > 480
    ink: Colour = (44, 38, 40) if pale else (240, 226, 196)
    words = ["THE", "LOST", "TIME", "OF", "LIGHT", "SEA", "NOTES", "ON", "WINTER", "ATLAS", "HOUSE"]
    title = " ".join(rng.choice(words, 3))
    letters(back, str(title), (138, 24), float(rng.uniform(15, 22)), ink, 1.6)
    for x in (14, 20, 238):
        cv2.line(back, (x, 0), (x, 47), pigment(ink), int(rng.integers(1, 4)))
    grain = on_paper(rng, back, 0.06)
    return np.ascontiguousarray(np.rot90(grain, -1))


def stencil(rng: np.random.Generator, boards: Picture) -> Picture:
    """A crate's side: boards with a stencilled mark."""
    side = boards.astype(np.float32)
    mark = np.zeros_like(side)
    height, width = side.shape[:2]
    letters(mark, "ORANGES", (width / 2, height * 0.36), height * 0.15, (255, 255, 255), 5)
    letters(mark, "VALENCIA  No 7", (width / 2, height * 0.66), height * 0.075, (255, 255, 255), 3)
    worn = (noise(rng, (height, width), (6, 6)) > -1.1).astype(np.float32)
    strength = mark[..., :1] / 255 * worn[..., None] * 0.82
    return finish(side * (1 - strength) + bgr((40, 52, 84)) * strength)


def face(rng: np.random.Generator, skin: Colour, hair_colour: Colour) -> Picture:
    """A child's head unrolled: 360 degrees wide, crown to chin, the face in the middle (320 x 640)."""
    height, width = 320, 640
    head = np.ones((height, width, 3), np.float32) * bgr(skin)
    y, x = np.mgrid[:height, :width].astype(np.float32)

    def blot(cx: float, cy: float, rx: float, ry: float) -> Floats:
        bump = np.exp(-(((x - cx) / rx) ** 2 + ((y - cy) / ry) ** 2))
        return np.asarray(bump[..., None], np.float32)

    for side in (-1, 1):
        cheek = blot(320 + side * 58, 212, 26, 20) * 0.55
        head = head * (1 - cheek) + bgr((224, 122, 104)) * cheek
        head *= 1 - 0.16 * blot(320 + side * 36, 164, 24, 17)
    head *= 1 + 0.10 * blot(320, 196, 9, 14)
    head *= 1 - 0.22 * blot(320, 211, 15, 5)
    head *= 1 - 0.12 * blot(320, 258, 30, 7)
    head = np.ascontiguousarray(head)
    for side in (-1, 1):
        eye = (320 + side * 36, 168)
        cv2.ellipse(head, eye, (18, 13), 0, 0, 360, pigment((246, 242, 236)), -1, cv2.LINE_AA)
        cv2.circle(head, eye, 11, pigment((92, 66, 44)), -1, cv2.LINE_AA)
        cv2.circle(head, eye, 6, pigment((20, 14, 14)), -1, cv2.LINE_AA)
        cv2.circle(head, (eye[0] - 4, eye[1] - 4), 3, pigment((255, 255, 255)), -1, cv2.LINE_AA)
        cv2.ellipse(head, eye, (19, 14), 0, 190, 350, pigment((52, 34, 28)), 3, cv2.LINE_AA)
        cv2.ellipse(head, (eye[0], 150), (22, 10), 0, 200, 340, pigment(hair_colour), 5, cv2.LINE_AA)
    cv2.ellipse(head, (320, 228), (31, 23), 0, 6, 174, pigment((150, 44, 46)), -1, cv2.LINE_AA)
    cv2.ellipse(head, (320, 229), (26, 9), 0, 4, 176, pigment((250, 246, 240)), -1, cv2.LINE_AA)
    cv2.ellipse(head, (320, 228), (33, 25), 0, 4, 176, pigment((168, 72, 66)), 3, cv2.LINE_AA)
    for _ in range(90):
        side = 1 if rng.random() < 0.5 else -1
        spot = (int(rng.normal(320 + side * 46, 22)), int(rng.normal(204, 10)))
        cv2.circle(head, spot, int(rng.integers(1, 3)), pigment((206, 142, 110)), -1, cv2.LINE_AA)
    rough = 0.035 * fractal(rng, (height, width), 24, 4) + 0.03 * noise(rng, (height, width), (3, 3))
    return finish(head * (1 + rough)[..., None])


def blade(rng: np.random.Generator, number: int) -> Picture:
    """Printed paper of one pinwheel blade (160 x 160): dots, stripes, stars, checks, waves or letters."""
    size = 160
    paper: Colour
    ink: Colour
    paper, ink = (
        ((226, 72, 58), (252, 236, 206)), ((250, 196, 66), (196, 60, 48)), ((52, 136, 190), (250, 240, 220)),
        ((246, 236, 216), (44, 62, 110)), ((92, 168, 98), (250, 232, 150)), ((232, 128, 160), (120, 40, 88)),
    )[number % 6]  # fmt: skip
    sheet = np.ones((size, size, 3), np.float32) * bgr(paper)
    y, x = np.mgrid[:size, :size].astype(np.float32)
    kind = number % 6
    if kind == 0:
        for _ in range(52):
            spot = rng.integers(0, size, 2)
            cv2.circle(
                sheet, (int(spot[0]), int(spot[1])), int(rng.integers(3, 10)), pigment(ink), -1, cv2.LINE_AA
            )
    elif kind == 1:
        sheet[((x + 0.4 * y + 9 * np.sin(y / 17)) % 26) < 11] = bgr(ink)
    elif kind == 2:
        for _ in range(26):
            cx, cy, r = rng.uniform(0, size), rng.uniform(0, size), rng.uniform(6, 14)
            turn = rng.uniform(0, 6.3)
            tips = [
                [cx + r * (1 if k % 2 == 0 else 0.42) * np.cos(turn + k * np.pi / 5),
                 cy + r * (1 if k % 2 == 0 else 0.42) * np.sin(turn + k * np.pi / 5)]
                for k in range(10)
            ]  # fmt: skip
            polygon(sheet, tips, ink)
    elif kind == 3:
        sheet[((x // 19).astype(int) + (y // 19).astype(int)) % 2 == 0] = bgr(ink)
        cv2.circle(sheet, (100, 96), 30, pigment((222, 82, 62)), -1, cv2.LINE_AA)
    elif kind == 4:
        sheet[np.sin(y / 7 + 2.2 * np.sin(x / 21)) > 0.35] = bgr(ink)
        cv2.circle(sheet, (60, 60), 22, pigment((40, 90, 66)), -1, cv2.LINE_AA)
    else:
        for k, line in enumerate(("wind", "round", "again", "blow")):
            letters(sheet, line, (82 + 9 * (k % 2), 22 + 38 * k), 30, ink, 4)
    return on_paper(rng, sheet, 0.06)


def ball(rng: np.random.Generator) -> Picture:
    """A beach ball unrolled (160 x 320)."""
    height, width = 160, 320
    x = np.arange(width)[None] * np.ones((height, 1))
    white: Colour = (246, 238, 224)
    colours: tuple[Colour, ...] = ((224, 70, 56), white, (244, 186, 60), white, (48, 112, 176), white)
    picture = np.stack([bgr(colour) for colour in colours])[(x // (width / 6)).astype(int) % 6]
    picture[:12] = bgr(white)
    return on_paper(rng, picture.astype(np.float32), 0.05)
