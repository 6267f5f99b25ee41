"""What is printed or painted on things: pigments and letters, book spines, the face, blades, the ball."""

import cv2
import numpy as np
from numpy.typing import ArrayLike

from capture_app.simulation.scenes.meshes import Floats, Reals
from capture_app.simulation.scenes.textures import Colour, Picture, bgr, finish, fractal, noise

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
