"""Procedural materials (wood, planks, bricks, a rug): sRGB, BGR, uint8."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.plugins.cameras.sim.scenes.stages import Floats, Picture

Reals = NDArray[np.floating[Any]]
Colour = tuple[float, float, float]
"""sRGB as red, green, blue in 0 to 255."""


def bgr(colour: Colour) -> Floats:
    """Return the colour in OpenCV's order, for float images of 0 to 255."""
    return np.array(colour[::-1], np.float32)


def noise(rng: np.random.Generator, shape: tuple[int, int], cell: tuple[float, float]) -> Floats:
    """Return smooth noise of mean 0, standard deviation 1; `cell` is its feature height and width, texels."""
    height, width = shape
    rows, columns = max(int(height / cell[0]), 2), max(int(width / cell[1]), 2)
    coarse = rng.standard_normal((rows, columns), dtype=np.float32)
    grown = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(grown / max(float(grown.std()), 1e-6), np.float32)


def fractal(rng: np.random.Generator, shape: tuple[int, int], largest: float, octaves: int) -> Floats:
    """Return a sum of noises, each of half the size and 0.65 of the strength of the previous; deviation 1."""
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
    """Return one colour with blotches and grain; `rough` is the standard deviation over the colour."""
    shade = 1 + rough * (0.6 * fractal(rng, shape, 40, 4) + 0.8 * noise(rng, shape, (1.5, 1.5)))
    return finish(shade[..., None] * bgr(colour))


def wood(
    rng: np.random.Generator, shape: tuple[int, int], colour: Colour, *, contrast: float = 1.0
) -> Picture:
    """Return wood grain along the width of the image."""
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
    """Return floor boards along the width of the image; `width` and `length` of a board are in texels."""
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
    """Return an old brick wall in running bond; `brick` is height and width of a brick and joint, texels."""
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


def kilim(rng: np.random.Generator, shape: tuple[int, int]) -> Picture:
    """Return a woven rug: borders of zigzags around a field of diamonds."""
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
