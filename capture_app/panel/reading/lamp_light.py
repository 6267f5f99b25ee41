"""How bright each lamp of a panel is in a picture, without the light of the room around it."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.panel.reading.finder import FoundPanel

Floats = NDArray[np.float64]

LINES = 3
"""Parts of a lamp whose exposure is reckoned apart: under a rolling shutter its top is earlier."""
_CORE = 0.8
"""Light is measured within this share of a lamp's size."""
_SAMPLES = 5
"""Samples across a lamp's core, and down."""
_FULL = 250
"""Levels from here on are saturated."""


@dataclass(frozen=True, slots=True)
class LampLight:
    """The light of a panel's lamps (n,) in a picture, in linear units, and the picture's rows (n, LINES) of
    their parts."""

    light: Floats
    """Above the ground next to each lamp."""
    ground: Floats
    saturated: NDArray[np.bool_]
    rows: Floats
    noise: float
    """Standard deviation of a lamp's light by the picture's noise."""


def measure(found: FoundPanel, picture: NDArray[np.uint8]) -> LampLight:
    """The light of each lamp in a picture (uint8 BGR), of the colour in which lamps stand out most."""
    lamps = found.panel.lamps
    middles = np.array([[lamp.x, lamp.y] for lamp in lamps])
    core = _core_places(found.panel.lamp_size * _CORE, square=found.panel.is_screen)
    levels = _sample(found, picture, middles, core)
    gaps = np.array([[x, y] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    around = _sample(found, picture, middles, gaps)
    saturated = (levels >= _FULL).mean(axis=1) > 0.2
    linear = to_linear(levels).mean(axis=1)
    ground = np.sort(to_linear(around), axis=1)[:, 1:3].mean(axis=1)
    light = linear - ground
    spread = np.percentile(light, 98, axis=0) - np.percentile(light, 30, axis=0)
    channel = int(np.argmax(spread * (1 - 0.9 * saturated.mean(axis=0) / max(0.02, float(saturated.mean())))))
    noise = _noise(to_linear(around)[..., channel])
    rows = np.sort(
        found.pixels((middles[:, None] + core).reshape(-1, 2))[:, 1].reshape(len(lamps), -1), axis=1
    )
    lines = np.stack([part.mean(axis=1) for part in np.array_split(rows, LINES, axis=1)], axis=1)
    return LampLight(light[:, channel], ground[:, channel], saturated[:, channel], lines, noise)


def to_linear(levels: Floats) -> Floats:
    """Light of levels (0 to 255) by sRGB's tone curve (IEC 61966-2-1), 1 for full."""
    share = levels / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def _core_places(size: float, *, square: bool) -> Floats:
    """Places (n, 2) around a lamp's middle, evenly over its core."""
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    if not square:
        places = places[np.hypot(*places.T) <= 0.5]
    return np.asarray(places * size)


def _sample(found: FoundPanel, picture: NDArray[np.uint8], middles: Floats, around: Floats) -> Floats:
    """Levels (n, places, channels) of a picture at places around each lamp."""
    at = found.pixels((middles[:, None] + around).reshape(-1, 2)).astype(np.float32)
    x, y = (at[:, axis].reshape(len(middles), -1) for axis in (0, 1))
    seen = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, float).reshape(len(middles), len(around), -1)


def _noise(ground: Floats) -> float:
    """Noise of a lamp's light by the differences of the grounds around it (n, 4)."""
    differences = np.abs(ground[:, 0] - ground[:, 1])
    return float(np.median(differences) / 0.954) + 1e-4
