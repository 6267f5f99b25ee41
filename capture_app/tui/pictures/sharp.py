"""Pictures in a terminal's own pixels where it can and textual-image is installed, decided here once.

Only by kitty's protocol with Unicode placeholders: its pictures are cells of text, which menus may cover, but
sixels are painted over whatever is there. WezTerm and Konsole claim that protocol without its placeholders;
they are told by the sixels that they have too.
"""

import importlib
import io
import os
import sys
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.segment import Segment
from textual.app import App
from textual.strip import Strip

from capture_app.tui.pictures.cells import Image, Palette, fitted_cells, palette_of, resample

MOST_CELLS = 297
"""Columns and rows that a placeholder can count."""


class SharpTerminal:
    """Sends pictures to a terminal that has kitty's protocol."""

    def __init__(self, picture: type[Any], cell: tuple[int, int]) -> None:
        """`picture`: textual-image's renderable; `cell`: width and height of a cell in pixels."""
        self._picture, self._cell = picture, cell

    def width_px(self, columns: int) -> int:
        """How many pixels so many columns are."""
        return min(columns, MOST_CELLS) * self._cell[0]

    def send(self, image: Image, columns: int, rows: int) -> "SharpPicture":
        """Send an image, fitted into so many cells; takes a second, for a thread."""
        height, width = image.shape[:2]
        across, down = fitted_cells(width, height, min(columns, MOST_CELLS), min(rows, MOST_CELLS))
        scaled = resample(np.ascontiguousarray(image), across * self._cell[0], down * self._cell[1])
        rgb = cv2.cvtColor(scaled, cv2.COLOR_GRAY2RGB if scaled.ndim == 2 else cv2.COLOR_BGR2RGB)
        pixels = importlib.import_module("PIL.Image").fromarray(rgb)
        return SharpPicture(self._picture(pixels, across, down), across, down)


class SharpPicture:
    """A picture that the terminal has, and the cells that stand for it."""

    def __init__(self, sent: Any, columns: int, rows: int) -> None:
        console = Console(width=columns, height=rows, file=io.StringIO(), color_system="truecolor")
        self._sent = sent
        self._lines = [list(line) for line in Segment.split_lines(console.render(sent))]
        self.columns, self.rows = columns, rows

    def strip(self, row: int) -> Strip:
        """A row of it."""
        return Strip(self._lines[row], self.columns)

    def forget(self) -> None:
        """Let the terminal forget it."""
        self._sent.cleanup()


def find_sharp_terminal(choice: str, environment: Mapping[str, str] = os.environ) -> SharpTerminal | None:
    """What draws in pixels here; None where glyphs have to do.

    `choice`: "glyphs" never; "sharp" over ssh too, where a picture of megabytes may take long; else locally.

    Importing textual-image asks the terminal what it can, on standard input: only before the screen is there.
    """
    remote = choice != "sharp" and bool(environment.keys() & {"SSH_CONNECTION", "SSH_TTY"})
    terminals = (sys.__stdin__, sys.__stdout__)
    if choice == "glyphs" or remote or not all(end is not None and end.isatty() for end in terminals):
        return None
    try:
        found = importlib.import_module("textual_image.renderable")
        if found.Image is not found.TGPImage:
            return None
        cell = importlib.import_module("textual_image._terminal").get_cell_size()
    except Exception:  # noqa: BLE001 - whatever is wrong with an optional package, glyphs are there
        return None
    return SharpTerminal(found.TGPImage, (cell.width, cell.height))


def sharp_terminal_of(app: App[Any]) -> SharpTerminal | None:
    """What draws in pixels on an app's terminal; in full colour only, as colours tell which picture it is."""
    found = getattr(app, "sharp_terminal", None)
    usable = isinstance(found, SharpTerminal) and palette_of(app) is Palette.TRUECOLOR
    return found if usable else None
