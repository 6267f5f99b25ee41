"""The pictures on the studio's walls: posters and a painted sea."""

import cv2
import numpy as np

from capture_app.simulation.scenes.meshes import Floats
from capture_app.simulation.scenes.prints import WARM, letters, on_paper, pigment, polygon
from capture_app.simulation.scenes.textures import Colour, Picture, bgr, noise


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
