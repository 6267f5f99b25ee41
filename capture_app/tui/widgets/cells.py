"""Rendering of an image in terminal cells: quarter blocks in two colours, or braille dots without colour."""

from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, lru_cache
from itertools import groupby
from operator import itemgetter
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.color import Color, ColorType
from rich.color_triplet import ColorTriplet
from rich.segment import Segment
from rich.style import Style
from textual.app import App
from textual.geometry import Size
from textual.strip import Strip

from capture_app.tui.widgets.painted import cell_codes

Image: TypeAlias = NDArray[np.uint8]
"""8-bit image, height x width or height x width x BGR."""

QUARTERS = "▀▘▌▚▛▜▙"
_INKED = np.array(
    [[1, 1, 0, 0], [1, 0, 0, 0], [1, 0, 1, 0], [1, 0, 0, 1], [1, 1, 1, 0], [1, 1, 0, 1], [1, 0, 1, 1]],
    np.float32,
)
"""Quarters in the foreground colour for each glyph of QUARTERS: upper two, lower two."""
_GLYPHS = np.array([list(glyph.encode()) for glyph in QUARTERS], np.uint8)
_CUBE = np.array([0, 95, 135, 175, 215, 255], np.uint8)
_BAYER = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]], np.float32)
_BRAILLE = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], np.int32)


class Palette(Enum):
    """Colour capability of the terminal."""

    TRUECOLOR = "truecolor"
    EIGHT_BIT = "256"
    GREYS = "greys"
    DOTS = "dots"
    """No colour: dithered braille dots."""

    @property
    def pixels(self) -> tuple[int, int]:
        """Pixel columns and rows per cell."""
        return (2, 4) if self is Palette.DOTS else (2, 2)


@dataclass(frozen=True)
class CellPicture:
    """Image in cells: `glyphs` is rows x columns, `inks` rows x columns x (foreground, background) x RGB.

    A glyph is an index into QUARTERS, or a braille pattern for dots.
    """

    palette: Palette
    glyphs: NDArray[np.uint8]
    inks: NDArray[np.uint8]

    @property
    def size(self) -> Size:
        """Columns and rows of cells."""
        return Size(*self.glyphs.shape[::-1])

    def strip(self, row: int, plain: Style) -> Strip:
        """Return a row as a Textual strip; `plain` is the style of dots."""
        glyphs = self.glyphs[row]
        if self.palette is Palette.DOTS:
            return Strip([Segment("".join(chr(0x2800 + int(dots)) for dots in glyphs), plain)], len(glyphs))
        inks = self.inks[row].astype(np.uint32)
        colours = ((inks[..., 0] << 16) | (inks[..., 1] << 8) | inks[..., 2]).tolist()
        is_cube = self.palette is Palette.EIGHT_BIT
        cells = zip(glyphs.tolist(), colours, strict=True)
        runs = (
            (ink, "".join(QUARTERS[glyph] for glyph, _ in run)) for ink, run in groupby(cells, itemgetter(1))
        )
        return Strip([Segment(text, _style(*ink, is_cube)) for ink, text in runs], len(glyphs))

    @cached_property
    def codes(self) -> NDArray[np.uint8]:
        """Codes of the cells for a terminal of true colours, rows x columns x bytes."""
        return cell_codes(_GLYPHS[self.glyphs], self.inks)

    def toned(self, *, is_grey: bool, faded_to: tuple[int, int, int] | None) -> "CellPicture":
        """Return the picture in grey, or half of it in the colour `faded_to`, or as it is."""
        if not is_grey and faded_to is None:
            return self
        inks = self.inks.mean(axis=-1, keepdims=True) if is_grey else self.inks.astype(np.float64)
        inks = inks if faded_to is None else (inks + faded_to) / 2
        toned = np.broadcast_to(inks, self.inks.shape).astype(np.uint8)
        return replace(self, inks=_nearest_of_256(toned) if self.palette is Palette.EIGHT_BIT else toned)

    def pixels(self) -> NDArray[np.uint8]:
        """Return the displayed colours: rows x columns x the 4 quarters of a cell x RGB."""
        return np.where(
            _INKED[self.glyphs][..., None] > 0, self.inks[:, :, None, 0], self.inks[:, :, None, 1]
        )


def palette_of(app: App[object]) -> Palette:
    """Return the palette of an app's terminal, given the user's NO_COLOR setting."""
    if app.no_color:
        # NO_COLOR makes the screen grey; with the terminal's own colours no greys are available.
        return Palette.DOTS if app.native_ansi_color else Palette.GREYS
    return Palette.EIGHT_BIT if app.console.color_system == "256" else Palette.TRUECOLOR


def fitted_cells(width: int, height: int, columns: int, rows: int) -> tuple[int, int]:
    """Return columns and rows of an image fitted into this space; a cell is twice as high as wide."""
    scale = min(columns / width, 2 * rows / height)
    return max(1, min(columns, round(width * scale))), max(1, min(rows, round(height * scale / 2)))


def resample(image: Image, width: int, height: int) -> Image:
    """Resize an image; averages over areas when shrinking."""
    shrinks = width <= image.shape[1] and height <= image.shape[0]
    return np.asarray(
        cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR),
        np.uint8,
    )


def grey_of(image: Image) -> Image:
    """Return the brightness of an image, height x width."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def draw_cells(scaled: Image, palette: Palette, *, light: bool = False) -> CellPicture:
    """Draw an image with the palette's pixels per cell; `light`: dark dots on a light background."""
    if palette is Palette.DOTS:
        glyphs = _dots(scaled, light=light)
        return CellPicture(palette, glyphs, np.zeros((*glyphs.shape, 2, 3), np.uint8))
    if palette is Palette.GREYS:
        scaled = grey_of(scaled)
    rgb = np.asarray(
        cv2.cvtColor(scaled, cv2.COLOR_GRAY2RGB if scaled.ndim == 2 else cv2.COLOR_BGR2RGB), np.float32
    )
    rows, columns = rgb.shape[0] // 2, rgb.shape[1] // 2
    quarters = rgb.reshape(rows, 2, columns, 2, 3).transpose(0, 2, 1, 3, 4).reshape(rows, columns, 4, 3)
    glyphs, inks = _split_in_two(quarters)
    if palette is Palette.EIGHT_BIT:
        inks = _nearest_of_256(inks)
    return CellPicture(palette, glyphs, inks)


def keep_equal_cells(shown: CellPicture, new: CellPicture, threshold: int) -> CellPicture:
    """Return the new picture, with the shown cell wherever its pixels differ by at most `threshold`.

    Otherwise sensor noise would cause every cell to be sent to the terminal again.
    """
    if new.palette is Palette.DOTS or (shown.palette, shown.glyphs.shape) != (new.palette, new.glyphs.shape):
        return new
    equal = np.abs(new.pixels().astype(np.int16) - shown.pixels()).max(axis=(2, 3)) <= threshold
    return CellPicture(
        new.palette,
        np.where(equal, shown.glyphs, new.glyphs),
        np.where(equal[..., None, None], shown.inks, new.inks),
    )


def changed_spans(shown: CellPicture, new: CellPicture) -> list[tuple[int, int, int]] | None:
    """Return (row, first changed column, last + 1) for each changed row of cells.

    Returns None if the sizes differ.
    """
    if shown.glyphs.shape != new.glyphs.shape:
        return None
    differs = (shown.glyphs != new.glyphs) | (shown.inks != new.inks).any(axis=(2, 3))
    rows = np.flatnonzero(differs.any(axis=1)).tolist()
    ends = [(row, np.flatnonzero(differs[row])[[0, -1]].tolist()) for row in rows]
    return [(row, first, last + 1) for row, (first, last) in ends]


@lru_cache(maxsize=16384)
def _style(front: int, back: int, eight_bit: bool) -> Style:
    return Style.from_color(_colour(front, eight_bit), _colour(back, eight_bit))


@lru_cache(maxsize=16384)
def _colour(rgb: int, eight_bit: bool) -> Color:
    red, green, blue = rgb >> 16, rgb >> 8 & 255, rgb & 255
    if not eight_bit:
        # Equivalent to Color.from_rgb, whose overhead would take half of a picture's drawing time.
        return Color(f"#{rgb:06x}", ColorType.TRUECOLOR, triplet=ColorTriplet(red, green, blue))
    if red == green == blue and red % 10 == 8 and red <= 238:
        return Color.from_ansi(232 + red // 10)
    steps = [int(np.searchsorted(_CUBE, value)) for value in (red, green, blue)]
    return Color.from_ansi(16 + 36 * steps[0] + 6 * steps[1] + steps[2])


def _split_in_two(quarters: NDArray[np.float32]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return each cell's glyph with the least squared error, and the mean colours of its two parts."""
    total = quarters.sum(axis=2)[:, :, None]
    inked = np.einsum("rcqk,gq->rcgk", quarters, _INKED, optimize=True)
    numbers = _INKED.sum(axis=1)[None, None, :, None]
    explained = (inked**2 / numbers + (total - inked) ** 2 / (4 - numbers)).sum(axis=3)
    # Prefer the half block when a quarter gains nothing, so that rounding does not make glyphs flicker.
    explained[..., 0] += 4.0
    glyphs = explained.argmax(axis=2)
    front = np.take_along_axis(inked, glyphs[..., None, None], axis=2)[:, :, 0]
    number = numbers[0, 0, :, 0][glyphs][..., None]
    inks = np.stack([front / number, (total[:, :, 0] - front) / (4 - number)], axis=2)
    return glyphs.astype(np.uint8), np.clip(np.round(inks), 0, 255).astype(np.uint8)


def _nearest_of_256(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the nearest colours in xterm's 216-colour cube and its 24 greys; the last axis is RGB."""
    middles = (_CUBE[1:].astype(np.int16) + _CUBE[:-1]) // 2
    cube = _CUBE[np.searchsorted(middles, rgb, side="left")]
    step = np.clip(np.round((rgb.mean(axis=-1, keepdims=True) - 8) / 10), 0, 23)
    grey = np.broadcast_to((8 + 10 * step).astype(np.uint8), rgb.shape)

    def error(of: NDArray[np.uint8]) -> NDArray[np.int32]:
        return np.asarray(((rgb.astype(np.int32) - of) ** 2).sum(axis=-1, keepdims=True), np.int32)

    return np.where(error(grey) < error(cube), grey, cube)


def _dots(scaled: Image, *, light: bool) -> NDArray[np.uint8]:
    # Few brightness levels remain, so the contrast of each region is equalized.
    grey = cv2.createCLAHE(clipLimit=4.0, tileGridSize=(4, 4)).apply(grey_of(scaled))
    contrast = np.asarray(cv2.addWeighted(grey, 1.8, cv2.GaussianBlur(grey, (0, 0), 2.0), -0.8, 0), np.uint8)
    rows, columns = grey.shape[0] // 4, grey.shape[1] // 2
    limits = np.tile((_BAYER + 0.5) * 16, (rows, columns // 2 + 1))[:, : 2 * columns]
    blocks = ((contrast[: 4 * rows, : 2 * columns] > limits) ^ light).reshape(rows, 4, columns, 2)
    return np.asarray(np.einsum("rycx,yx->rc", blocks.astype(np.int32), _BRAILLE), np.uint8)
