"""Focus and exposure aids: marks on an image, focus value, brightness and histogram."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from textual.content import Content

from capture_app.tui.widgets.cells import Image, grey_of
from capture_app.tui.widgets.lines import bar_rows

Bgr: TypeAlias = tuple[int, int, int]

SHARP_EDGE = 24.0
"""Second derivative (8-bit levels) from which an edge counts as sharp."""
BLACK, WHITE = 4, 251
"""Levels at or beyond which a pixel counts as clipped."""
PEAK_COLOUR: Bgr = (60, 60, 255)
HIGHLIGHT_COLOUR: Bgr = (0, 200, 255)
SHADOW_COLOUR: Bgr = (255, 120, 0)
SHOWN_FROM = 0.12
"""Fraction of a screen pixel's area that must be marked for the pixel to be marked."""
BEST_OVER_S = 10.0
"""Time over which a focus value is compared with the best, in seconds; enough to turn a focus ring both
ways."""
IN_FOCUS = 0.95
"""Fraction of the best value from which the image is in focus."""
CLIPPED = 0.01
"""Fraction of clipped pixels from which a warning is shown."""


Mark: TypeAlias = tuple[NDArray[np.bool_], Bgr, bool]
"""Mask of the pixels of an image to paint over, their colour, and whether they are striped."""
Aid: TypeAlias = Callable[[Image], Sequence[Mark]]


@dataclass(frozen=True, slots=True)
class Exposure:
    """Exposure of an image; `histogram` is the fraction of pixels per bin, dark first."""

    histogram: tuple[float, ...]
    mean: float
    """Mean brightness, 0 to 255."""
    shadows: float
    """Fraction of pixels clipped to black in all channels."""
    highlights: float
    """Fraction of pixels clipped to white in any channel."""


def sharpness(image: Image) -> float:
    """Return a focus value: mean squared Laplacian (Subbarao et al. 1993) over squared mean, in percent.

    It is greatest in focus. Normalizing by brightness keeps it comparable under changing light.
    """
    grey = cv2.GaussianBlur(grey_of(image).astype(np.float32), (3, 3), 0)
    mean = float(grey.mean())
    return 100.0 * float((cv2.Laplacian(grey, cv2.CV_32F) ** 2).mean()) / mean**2 if mean >= 1.0 else 0.0


def peaking(image: Image) -> Sequence[Mark]:
    """Mark sharp edges."""
    second = np.abs(cv2.Laplacian(cv2.GaussianBlur(grey_of(image), (3, 3), 0), cv2.CV_32F))
    return ((second >= SHARP_EDGE, PEAK_COLOUR, False),)


def zebra(image: Image) -> Sequence[Mark]:
    """Mark clipped highlights and shadows with stripes."""
    shadows, highlights = _clipped(image)
    return (highlights, HIGHLIGHT_COLOUR, True), (shadows, SHADOW_COLOUR, True)


def exposure_of(image: Image, bins: int = 64) -> Exposure:
    """Measure an image's exposure."""
    grey = grey_of(image)
    counts = np.bincount((grey.astype(np.uint16) * bins >> 8).ravel(), minlength=bins)
    shadows, highlights = _clipped(image)
    return Exposure(
        histogram=tuple((counts / grey.size).tolist()),
        mean=float(grey.mean()),
        shadows=float(shadows.mean()),
        highlights=float(highlights.mean()),
    )


def paint_marks(scaled: Image, image: Image, aids: Sequence[Aid]) -> Image:
    """Paint the marks found in `image` onto its `scaled` version."""
    marks = [mark for aid in aids for mark in aid(image)]
    if not marks:
        return scaled
    painted = cv2.cvtColor(scaled, cv2.COLOR_GRAY2BGR) if scaled.ndim == 2 else scaled.copy()
    height, width = scaled.shape[:2]
    for mask, colour, striped in marks:
        cover = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        where = cover >= SHOWN_FROM
        if striped:
            where &= np.add.outer(np.arange(height), np.arange(width)) % 4 < 2
        painted[where] = colour
    return np.asarray(painted, np.uint8)


def _clipped(image: Image) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    channels = image if image.ndim == 3 else image[..., None]
    shadows, highlights = channels.max(axis=2) <= BLACK, channels.max(axis=2) >= WHITE
    return np.asarray(shadows, np.bool_), np.asarray(highlights, np.bool_)


def focus_line(numbers: Sequence[tuple[float, float]], width: int = 24) -> Content:
    """Return the newest focus value and its ratio to the recent best; `numbers` are (time in s, value)."""
    lately = [number for when_s, number in numbers if when_s >= numbers[-1][0] - BEST_OVER_S]
    if not lately or max(lately) <= 0:
        return Content.styled("focus   no picture yet", "$foreground-muted")
    fraction = lately[-1] / max(lately)
    filled = round(fraction * width)
    style = "$success" if fraction >= IN_FOCUS else "$warning"
    return Content.assemble(
        ("focus   ", "$foreground-muted"),
        (f"{lately[-1]:7.3f}  ", "bold"),
        ("█" * filled, style),
        ("░" * (width - filled), "$foreground-muted"),
        (f" {fraction:4.0%} of the best in {BEST_OVER_S:g} s", style),
    )


def exposure_line(exposure: Exposure) -> Content:
    """Return mean brightness and clipping in a line."""

    def clipped(fraction: float, name: str, glyph: str) -> tuple[str, str]:
        mark, style = (glyph, "$warning") if fraction >= CLIPPED else (" ", "$foreground-muted")
        return f"  {mark} {name} {fraction:.1%}", style

    return Content.assemble(
        ("light   ", "$foreground-muted"),
        (f"{exposure.mean / 255:7.1%}", "bold"),
        clipped(exposure.shadows, "clipped black", "▼"),
        clipped(exposure.highlights, "clipped white", "▲"),
    )


def histogram_lines(exposure: Exposure, width: int, height: int) -> list[Content]:
    """Return the histogram in lines, dark left; a square-root scale keeps small bins visible."""
    bins = exposure.histogram
    firsts = [column * len(bins) // width for column in range(width + 1)]
    columns = [max(bins[first : max(end, first + 1)]) for first, end in pairwise(firsts)]
    highest = max(columns, default=0.0) or 1.0
    eighths = [max(round((one / highest) ** 0.5 * 8 * height), 1) if one > 0 else 0 for one in columns]
    return [Content.styled(row, "$primary") for row in bar_rows(eighths, height)]
