"""Drawing on textures: pigments, polygons, letters, the grain of paper."""

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
