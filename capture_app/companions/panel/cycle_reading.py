"""Reading of a screen panel's cycle code from an image."""

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.companions.panel.cycle_code import Cycle, cell_places, decode_cycle
from capture_app.companions.panel.finder import Floats, FoundPanel

_WHITE_AT = 3.6
"""Distance of the white ground that a row's cells are compared with."""
_CLEAR = 0.15
"""Minimum distance of a cell from the middle between black and white, relative to their difference."""


def read_cycle(panel: FoundPanel, grey: NDArray[np.uint8]) -> Cycle | None:
    """Return the cycle that a screen's panel shows in an image, or None if it shows none that is readable."""
    if not panel.panel.is_screen:
        return None
    places = np.array(cell_places(panel.panel)) + 0.5
    near = np.array([[x, y] for x in (-0.2, 0.0, 0.2) for y in (-0.2, 0.0, 0.2)])
    levels = _levels(panel, grey, (places[:, None] + near).reshape(-1, 2)).reshape(len(places), -1).mean(1)
    side = np.where(places[:, 0] < panel.panel.width / 2, _WHITE_AT, panel.panel.width - _WHITE_AT)
    white = _levels(panel, grey, np.column_stack([side, places[:, 1]]))
    # A marker's border is black, and half a square wide from its edge to the border's middle.
    middles = np.array([[left + 0.25, top + 1.5] for _, left, top in panel.panel.markers])
    black = float(np.median(_levels(panel, grey, middles)))
    whiteness = (levels - black) / np.maximum(white - black, 1.0)
    if (np.abs(whiteness - 0.5) < _CLEAR).any():
        return None
    return decode_cycle(tuple(int(level < 0.5) for level in whiteness))


def _levels(panel: FoundPanel, grey: NDArray[np.uint8], places: Floats) -> Floats:
    """Return the image's levels (n,) at points (n, 2) of the panel."""
    x, y = panel.pixels(places).astype(np.float32).T
    seen = cv2.remap(
        grey, x[:, None].copy(), y[:, None].copy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(seen, float).ravel()
