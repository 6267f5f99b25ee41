"""Drawn pictures of the scene: posters, book spines, the face, the pinwheel's prints."""

import cv2
import numpy as np

from capture_app.simulation.meshes import Floats
from capture_app.simulation.textures import Colour, Picture, bgr, finish, fractal, noise

WARM: tuple[Colour, ...] = (
    (196, 68, 54), (226, 148, 60), (240, 208, 120), (64, 118, 128), (44, 62, 96), (226, 214, 190), (120, 148, 92),
)  # fmt: skip


def _ink(colour: Colour) -> list[float]:
    return [float(c) for c in colour[::-1]]


def _grain(rng: np.random.Generator, picture: Floats, strength: float = 0.035) -> Picture:
    shape = (picture.shape[0], picture.shape[1])
    rough = strength * (noise(rng, shape, (1.7, 1.7)) + 0.8 * fractal(rng, shape, 30, 4))
    return finish(picture * (1 + rough)[..., None])


def _text(
    picture: Floats,
    text: str,
    centre: tuple[float, float],
    height: float,
    colour: Colour,
    weight: float = 2.0,
) -> None:
    font, scale = cv2.FONT_HERSHEY_DUPLEX, height / 22.0
    (width, tall), _ = cv2.getTextSize(text, font, scale, max(int(weight), 1))
    at = (int(centre[0] - width / 2), int(centre[1] + tall / 2))
    mask = np.zeros(picture.shape[:2], np.uint8)
    cv2.putText(mask, text, at, font, scale, 255, max(int(weight), 1), cv2.LINE_AA)
    cover = mask[..., None].astype(np.float32) / 255
    picture[:] = picture * (1 - cover) + bgr(colour) * cover


def mountains(rng: np.random.Generator) -> Picture:
    """Travel poster: ranges of hills before an evening sun (420 x 300)."""
    height, width = 420, 300
    t = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
    poster = np.broadcast_to(
        bgr((250, 196, 120)) * t + bgr((88, 130, 160)) * (1 - t), (height, width, 3)
    ).copy()
    cv2.circle(poster, (196, 170), 44, _ink((252, 236, 196)), -1, cv2.LINE_AA)
    x = np.arange(width)
    for step, colour in enumerate(
        ((206, 132, 108), (160, 92, 96), (104, 70, 92), (54, 48, 76), (28, 32, 52))
    ):
        ridge = 190 + 40 * step + sum(
            rng.uniform(6, 26) / k * np.sin(x * 0.012 * k + rng.uniform(0, 6.3)) for k in range(1, 7)
        )  # fmt: skip
        outline = np.stack([np.r_[x, width - 1, 0], np.r_[ridge, height, height]], -1).astype(np.int32)
        cv2.fillPoly(poster, [outline], _ink(colour), cv2.LINE_AA)
    for _ in range(46):
        tree_x, base = rng.uniform(0, width), rng.uniform(372, 420)
        size = rng.uniform(14, 34)
        cv2.fillPoly(
            poster,
            [np.int32([[tree_x - size / 4, base], [tree_x + size / 4, base], [tree_x, base - size]])],
            _ink((16, 22, 34)),
            cv2.LINE_AA,
        )
    _text(poster, "ALPENGLOW", (150, 44), 27, (250, 240, 220), 2)
    _text(poster, "summer trains 1962", (150, 72), 12, (250, 240, 220), 1)
    return _grain(rng, poster)


def shapes(rng: np.random.Generator) -> Picture:
    """Exhibition poster of plain shapes (400 x 300)."""
    poster = np.ones((400, 300, 3), np.float32) * bgr((232, 220, 198))
    cv2.circle(poster, (112, 140), 78, _ink(WARM[0]), -1, cv2.LINE_AA)
    cv2.ellipse(poster, (190, 190), (84, 84), 0, -90, 90, _ink(WARM[4]), -1, cv2.LINE_AA)
    cv2.rectangle(poster, (36, 214), (134, 300), _ink(WARM[1]), -1)
    cv2.fillPoly(poster, [np.int32([[150, 306], [262, 306], [206, 216]])], _ink(WARM[3]), cv2.LINE_AA)
    for k in range(9):
        cv2.line(poster, (36 + k * 11, 214), (36 + k * 11, 300), _ink(WARM[5]), 2, cv2.LINE_AA)
    for k in range(7):
        cv2.circle(poster, (190, 190), 12 + k * 11, _ink(WARM[5]), 1, cv2.LINE_AA)
    _text(poster, "form + time", (150, 340), 26, (36, 40, 56), 2)
    _text(poster, "twelve evenings of moving pictures", (150, 372), 9, (36, 40, 56), 1)
    return _grain(rng, poster)


def harbour(rng: np.random.Generator) -> Picture:
    """Painted sea with sailing boats, landscape format (260 x 380)."""
    height, width = 260, 380
    t = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
    sea = np.broadcast_to(bgr((236, 214, 178)) * (1 - t) + bgr((38, 84, 110)) * t, (height, width, 3)).copy()
    sea[120:] = sea[120:] * 0.4 + bgr((40, 104, 128)) * 0.6
    sea += (
        16 * noise(rng, (height, width), (9, 60))[..., None]
        + 9 * noise(rng, (height, width), (4, 18))[..., None]
    )
    for x, base, size in ((84, 176, 80), (236, 196, 108), (320, 150, 44)):
        cv2.fillPoly(
            sea,
            [np.int32([[x, base], [x, base - size], [x + size * 0.5, base]])],
            _ink((246, 238, 222)),
            cv2.LINE_AA,
        )
        cv2.fillPoly(
            sea,
            [np.int32([[x - 4, base], [x - 4, base - size * 0.85], [x - size * 0.36, base]])],
            _ink(WARM[0]),
            cv2.LINE_AA,
        )
        hull = np.int32(
            [
                [x - size * 0.42, base + 4],
                [x + size * 0.55, base + 4],
                [x + size * 0.3, base + size * 0.2],
                [x - size * 0.28, base + size * 0.2],
            ]
        )
        cv2.fillPoly(sea, [hull], _ink((52, 40, 40)), cv2.LINE_AA)
    for _ in range(240):
        x, y = rng.uniform(0, width), rng.uniform(150, height)
        cv2.line(
            sea,
            (int(x), int(y)),
            (int(x + rng.uniform(6, 22)), int(y)),
            _ink((188, 214, 214)),
            1,
            cv2.LINE_AA,
        )
    return _grain(rng, sea, 0.05)


def words(rng: np.random.Generator) -> Picture:
    """Typographic poster (420 x 300)."""
    poster = np.ones((420, 300, 3), np.float32) * bgr((214, 92, 58))
    for k, (line, size) in enumerate((("MANY", 62), ("EYES", 68), ("ONE", 74), ("BLINK", 54))):
        _text(poster, line, (150, 62 + k * 84), size, (250, 234, 206), 7)
    for k in range(9):
        cv2.circle(poster, (30 + k * 30, 392), 9, _ink((250, 234, 206)), 2 + (k % 3) * 3, cv2.LINE_AA)
    return _grain(rng, poster)


def city(rng: np.random.Generator) -> Picture:
    """Night skyline with lit windows (300 x 420)."""
    height, width = 300, 420
    t = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
    night = np.broadcast_to(bgr((28, 34, 66)) * (1 - t) + bgr((178, 96, 96)) * t, (height, width, 3)).copy()
    cv2.circle(night, (318, 60), 24, _ink((246, 236, 208)), -1, cv2.LINE_AA)
    left = -10
    while left < width:
        wide, top = int(rng.integers(26, 60)), int(rng.integers(80, 210))
        tone = float(rng.uniform(0.6, 1.3))
        cv2.rectangle(night, (left, top), (left + wide, height), _ink((30 * tone, 32 * tone, 52 * tone)), -1)
        for y in range(top + 7, height, 11):
            for x in range(left + 5, left + wide - 5, 9):
                if rng.random() < 0.55:
                    glow = rng.uniform(0.5, 1.0)
                    cv2.rectangle(
                        night, (x, y), (x + 4, y + 5), _ink((250 * glow, 206 * glow, 120 * glow)), -1
                    )
        left += wide + int(rng.integers(-6, 6))
    return _grain(rng, night)


def spine(rng: np.random.Generator) -> Picture:
    """A book's back, title running down it (256 x 48)."""
    colour = WARM[int(rng.integers(0, len(WARM)))]
    back = np.ones((48, 256, 3), np.float32) * bgr(colour) * float(rng.uniform(0.65, 1.1))
    pale = sum(colour) > 480
    ink: Colour = (44, 38, 40) if pale else (240, 226, 196)
    title = " ".join(
        rng.choice(
            ["THE", "LOST", "TIME", "OF", "LIGHT", "SEA", "NOTES", "ON", "WINTER", "ATLAS", "HOUSE"], 3
        )
    )
    _text(back, str(title), (138, 24), float(rng.uniform(15, 22)), ink, 1.6)
    for x in (14, 20, 238):
        cv2.line(back, (x, 0), (x, 47), _ink(ink), int(rng.integers(1, 4)))
    grain = _grain(rng, back, 0.06)
    return np.ascontiguousarray(np.rot90(grain, -1))


def stencil(rng: np.random.Generator, boards: Picture) -> Picture:
    """A crate's side: boards with a stencilled mark."""
    side = boards.astype(np.float32)
    mark = np.zeros_like(side)
    height, width = side.shape[:2]
    _text(mark, "ORANGES", (width / 2, height * 0.36), height * 0.15, (255, 255, 255), 5)
    _text(mark, "VALENCIA  No 7", (width / 2, height * 0.66), height * 0.075, (255, 255, 255), 3)
    worn = (noise(rng, (height, width), (6, 6)) > -1.1).astype(np.float32)
    strength = mark[..., :1] / 255 * worn[..., None] * 0.82
    return finish(side * (1 - strength) + bgr((40, 52, 84)) * strength)


def face(rng: np.random.Generator, skin: Colour, hair_colour: Colour) -> Picture:
    """A child's head unrolled: 360 degrees wide, crown to chin, the face in the middle (320 x 640)."""
    height, width = 320, 640
    head = np.ones((height, width, 3), np.float32) * bgr(skin)
    y, x = np.mgrid[:height, :width].astype(np.float32)

    def blot(cx: float, cy: float, rx: float, ry: float) -> Floats:
        return np.exp(-(((x - cx) / rx) ** 2 + ((y - cy) / ry) ** 2))[..., None].astype(np.float32)

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
        cv2.ellipse(head, eye, (18, 13), 0, 0, 360, _ink((246, 242, 236)), -1, cv2.LINE_AA)
        cv2.circle(head, eye, 11, _ink((92, 66, 44)), -1, cv2.LINE_AA)
        cv2.circle(head, eye, 6, _ink((20, 14, 14)), -1, cv2.LINE_AA)
        cv2.circle(head, (eye[0] - 4, eye[1] - 4), 3, _ink((255, 255, 255)), -1, cv2.LINE_AA)
        cv2.ellipse(head, eye, (19, 14), 0, 190, 350, _ink((52, 34, 28)), 3, cv2.LINE_AA)
        cv2.ellipse(head, (eye[0], 150), (22, 10), 0, 200, 340, _ink(hair_colour), 5, cv2.LINE_AA)
    cv2.ellipse(head, (320, 228), (31, 23), 0, 6, 174, _ink((150, 44, 46)), -1, cv2.LINE_AA)
    cv2.ellipse(head, (320, 229), (26, 9), 0, 4, 176, _ink((250, 246, 240)), -1, cv2.LINE_AA)
    cv2.ellipse(head, (320, 228), (33, 25), 0, 4, 176, _ink((168, 72, 66)), 3, cv2.LINE_AA)
    for _ in range(90):
        side = 1 if rng.random() < 0.5 else -1
        spot = (int(rng.normal(320 + side * 46, 22)), int(rng.normal(204, 10)))
        cv2.circle(head, spot, int(rng.integers(1, 3)), _ink((206, 142, 110)), -1, cv2.LINE_AA)
    rough = 0.035 * fractal(rng, (height, width), 24, 4) + 0.03 * noise(rng, (height, width), (3, 3))
    return finish(head * (1 + rough)[..., None])


def blade(rng: np.random.Generator, number: int) -> Picture:
    """Printed paper of one pinwheel blade (160 x 160): dots, stripes, stars, checks, waves or letters."""
    size = 160
    paper: Colour = (
        (226, 72, 58),
        (250, 196, 66),
        (52, 136, 190),
        (246, 236, 216),
        (92, 168, 98),
        (232, 128, 160),
    )[number % 6]
    ink: Colour = (
        (252, 236, 206),
        (196, 60, 48),
        (250, 240, 220),
        (44, 62, 110),
        (250, 232, 150),
        (120, 40, 88),
    )[number % 6]
    sheet = np.ones((size, size, 3), np.float32) * bgr(paper)
    y, x = np.mgrid[:size, :size].astype(np.float32)
    kind = number % 6
    if kind == 0:
        for _ in range(52):
            spot = rng.integers(0, size, 2)
            cv2.circle(
                sheet, (int(spot[0]), int(spot[1])), int(rng.integers(3, 10)), _ink(ink), -1, cv2.LINE_AA
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
            cv2.fillPoly(sheet, [np.int32(tips)], _ink(ink), cv2.LINE_AA)
    elif kind == 3:
        sheet[((x // 19).astype(int) + (y // 19).astype(int)) % 2 == 0] = bgr(ink)
        cv2.circle(sheet, (100, 96), 30, _ink((222, 82, 62)), -1, cv2.LINE_AA)
    elif kind == 4:
        sheet[np.sin(y / 7 + 2.2 * np.sin(x / 21)) > 0.35] = bgr(ink)
        cv2.circle(sheet, (60, 60), 22, _ink((40, 90, 66)), -1, cv2.LINE_AA)
    else:
        for k, line in enumerate(("wind", "round", "again", "blow")):
            _text(sheet, line, (82 + 9 * (k % 2), 22 + 38 * k), 30, ink, 4)
    return _grain(rng, sheet, 0.06)


def ball(rng: np.random.Generator) -> Picture:
    """A beach ball unrolled (160 x 320)."""
    height, width = 160, 320
    x = np.arange(width)[None] * np.ones((height, 1))
    panels = np.stack(
        [
            bgr(c)
            for c in (
                (224, 70, 56),
                (246, 238, 224),
                (244, 186, 60),
                (246, 238, 224),
                (48, 112, 176),
                (246, 238, 224),
            )
        ]
    )
    picture = panels[(x // (width / 6)).astype(int) % 6]
    picture[:12] = bgr((246, 238, 224))
    return _grain(rng, picture.astype(np.float32), 0.05)
