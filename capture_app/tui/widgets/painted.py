"""Row of a picture whose escape sequences NumPy made: a terminal's line without an object for each colour."""

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rich.color import ColorSystem
from rich.console import Console
from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

TEMPLATE = np.frombuffer(b"\x1b[38;2;RRR;GGG;BBB;48;2;RRR;GGG;BBBm???", np.uint8)
"""Codes of a cell: its two colours, and its glyph in UTF-8. A byte of 0 is not sent."""
GLYPH_BYTES = 3
_NUMBERS = np.array([list(f"{number:\0>3}".encode()) for number in range(256)], np.uint8)
RESET = "\x1b[0m"


def cell_codes(glyphs: NDArray[np.uint8], inks: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the codes of cells, ... x bytes, from their glyphs in UTF-8 and their inks as in CellPicture."""
    codes = np.tile(TEMPLATE, (*inks.shape[:-2], 1))
    for at, channel in zip((7, 11, 15, 24, 28, 32), range(6), strict=True):
        codes[..., at : at + 3] = _NUMBERS[inks[..., channel // 3, channel % 3]]
    codes[..., -GLYPH_BYTES:] = glyphs
    return codes


def blank_code(style: Style) -> NDArray[np.uint8]:
    """Return the code of an empty cell on a style's background."""
    ansi = Strip.render_ansi(Style(bgcolor=style.bgcolor), ColorSystem.TRUECOLOR)
    code = f"\x1b[{ansi or 0}m".encode().ljust(len(TEMPLATE) - GLYPH_BYTES, b"\0")
    return np.frombuffer(code + b" \0\0", np.uint8)


class PaintedStrip(Strip):
    """Strip of cells with their codes; what asks for its segments has them made."""

    def __init__(self, codes: NDArray[np.uint8], make: Callable[[], Iterable[Segment]]) -> None:
        """`codes`: cells x bytes; `make` returns the same cells as segments."""
        super().__init__((), len(codes))
        self._codes, self._make = codes, make
        del self._segments  # made when they are first asked for

    @cached_property
    def _segments(self) -> list[Segment]:  # type: ignore[override]
        return list(self._make())

    def crop(self, start: int, end: int | None = None) -> Strip:
        """Return the cells from `start` to before `end`."""
        codes = self._codes[max(0, start) : end]
        return PaintedStrip(codes, lambda: Strip(self._segments, self.cell_length).crop(start, end))

    def divide(self, cuts: Iterable[int]) -> Sequence[Strip]:
        """Return the cells between these places."""
        return [self.crop(*ends) for ends in pairwise((0, *cuts)) if ends[1] <= self.cell_length]

    def render(self, console: Console) -> str:
        """Return the text for the terminal, in which a colour that stays is not said again."""
        if console.color_system != "truecolor":
            return super().render(console)
        codes = self._codes.copy()
        stays = (self._codes[1:, :-GLYPH_BYTES] == self._codes[:-1, :-GLYPH_BYTES]).all(axis=1)
        codes[1:, :-GLYPH_BYTES][stays] = 0
        return bytes(codes[codes != 0]).decode() + RESET
