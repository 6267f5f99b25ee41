"""A small animation to share: two sequences side by side, there and back, as a GIF that plays anywhere."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from reconstruction.common.geometry import Array

PANEL_PX, MANY = 400, 8
"""Longest side of each half; of more pictures than that, two thirds."""
STRIP_PX = 34
GAP_PX = 6
STEP_MS, REST_MS = 160, 480
PAPER, INK = (26, 22, 20), (226, 231, 233)
TONES = ((255, 179, 109), (87, 156, 255))
"""BGR of the marks of the first and the second sequence, those of the report in the dark."""


def save_animation(
    folder: Path,
    name: str,
    halves: tuple[Sequence[Array], Sequence[Array]],
    titles: tuple[str, Sequence[str]],
) -> str:
    """Write folder/pictures/`name`.gif and return its path relative to the folder.

    `halves` are pictures (BGR uint8) of equal number and size; `titles` are that of the first half and those
    of each picture of the second.
    """
    side = PANEL_PX if len(halves[0]) <= MANY else PANEL_PX * 2 // 3
    there = [
        np.hstack(
            [
                left := _panel(first, titles[0], TONES[0], side),
                _gap(left),
                _panel(second, title, TONES[1], side),
            ]
        )
        for first, second, title in zip(*halves, titles[1], strict=True)
    ]
    animation = cv2.Animation()
    animation.frames = there + there[-2:0:-1]
    animation.durations = [
        REST_MS if k in (0, len(there) - 1) else STEP_MS for k in range(len(animation.frames))
    ]
    animation.loop_count = 0
    target = folder / "pictures" / f"{name}.gif"
    target.parent.mkdir(parents=True, exist_ok=True)
    # Smaller and smoother than the writer's defaults: error diffusion, eight bits of colour.
    how = [cv2.IMWRITE_GIF_DITHER, 3, cv2.IMWRITE_GIF_QUALITY, 8]
    if not cv2.imwriteanimation(str(target), animation, how):
        raise OSError(f"cannot write {target}")
    return f"pictures/{name}.gif"


def _panel(picture: Array, title: str, tone: tuple[int, int, int], side: int) -> Array:
    scale = side / max(picture.shape[:2])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    strip = np.full((STRIP_PX, small.shape[1], 3), PAPER, np.uint8)
    middle = STRIP_PX // 2
    cv2.circle(strip, (middle, middle), 6, tone, cv2.FILLED, cv2.LINE_AA)
    cv2.putText(strip, title, (middle + 15, middle + 6), INK, cv2.FontFace("sans"), 16, 500)
    return np.vstack([strip, small])


def _gap(panel: Array) -> Array:
    return np.full((panel.shape[0], GAP_PX, 3), PAPER, np.uint8)
