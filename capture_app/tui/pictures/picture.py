"""A widget that shows an image fitted into its cells."""

import asyncio
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from rich.segment import Segment
from textual import work
from textual.geometry import Region
from textual.strip import Strip
from textual.widget import Widget

from capture_app.session.reading.decoding import decode_image
from capture_app.text import printable
from capture_app.tui.pictures.aids import Aid, paint_marks
from capture_app.tui.pictures.cells import (
    CellPicture,
    Image,
    Palette,
    changed_spans,
    draw_cells,
    fitted_cells,
    keep_what_looks_alike,
    palette_of,
    resample,
    strip_of,
)

Source: TypeAlias = bytes | Image | Callable[[], "bytes | Image | None"]
"""An image file's bytes, pixels (BGR or grey), or what loads one of these, called in a thread."""

NOISE = 12
"""Colours (of 255) by which a cell of a live picture may differ from what is shown and is not sent again.

A sensor's noise would else have nearly all sent each time: a third of the bytes, by `benchmarks/previews.py`.
"""


class Picture(Widget):
    """Shows an image as large as it fits, in its proportions; `words` stand where there is none."""

    DEFAULT_CSS = """
    Picture { width: 1fr; height: 1fr; }
    """

    def __init__(
        self,
        source: Source | None = None,
        *,
        words: str = "",
        noise: int = 0,
        id: str | None = None,
        classes: str | None = None,
    ) -> None:
        """`noise`: cells that differ by no more are left as they are, see NOISE."""
        super().__init__(id=id, classes=classes)
        self._source = source
        self._noise = noise
        self._words = printable(words)
        self._aids: tuple[Aid, ...] = ()
        self._cells: CellPicture | None = None
        self._drawing = False
        self._stale = source is not None

    @property
    def cells(self) -> CellPicture | None:
        """What is drawn now."""
        return self._cells

    @property
    def words(self) -> str:
        """What stands in the middle where there is no picture."""
        return self._words

    def show(self, source: Source | None, words: str | None = None) -> None:
        """Show this image instead; nothing happens where it is the same."""
        if words is not None and printable(words) != self._words:
            self._words = printable(words)
            self.refresh()
        if source is self._source or (isinstance(source, bytes) and source == self._source):
            return
        self._source = source
        self._draw_again()

    def show_aids(self, aids: Sequence[Aid]) -> None:
        """Mark parts of the picture by these."""
        if tuple(aids) != self._aids:
            self._aids = tuple(aids)
            self._draw_again()

    def on_mount(self) -> None:
        """Dots are dark on a light theme."""
        self.app.theme_changed_signal.subscribe(self, lambda _: self._draw_again())

    def on_resize(self) -> None:
        """Draw it again in the new size."""
        self._draw_again()

    def render_line(self, y: int) -> Strip:
        """One line of the picture."""
        width, plain = self.size.width, self.rich_style
        cells = self._cells
        if cells is None:
            words = self._words if y == self.size.height // 2 else ""
            return Strip([Segment(words[:width].center(width), plain)], width)
        row = y - (self.size.height - cells.rows) // 2
        if not 0 <= row < cells.rows or cells.columns > width:
            return Strip.blank(width, plain)
        left = (width - cells.columns) // 2
        strips = [Strip.blank(left, plain), strip_of(cells, row, plain)]
        return Strip.join([*strips, Strip.blank(width - left - cells.columns, plain)])

    def _draw_again(self) -> None:
        self._stale = True
        if not self._drawing and self.is_mounted and self.size:
            self._drawing = True
            self._draw()

    @work
    async def _draw(self) -> None:
        """Draw the newest image until no newer one is there; those between are never drawn."""
        try:
            while self._stale and self.size:
                self._stale = False
                size, palette = (self.size.width, self.size.height), palette_of(self.app)
                light = not self.app.current_theme.dark
                new = await asyncio.to_thread(_fit, self._source, *size, self._aids, palette, light=light)
                self._put(new)
        finally:
            self._drawing = False

    def _put(self, new: CellPicture | None) -> None:
        shown = self._cells
        if shown is not None and new is not None:
            new = keep_what_looks_alike(shown, new, self._noise)
        self._cells = new
        spans = None if shown is None or new is None else changed_spans(shown, new)
        if spans is None or new is None:
            self.refresh()
        elif spans:
            left, top = (self.size.width - new.columns) // 2, (self.size.height - new.rows) // 2
            self.refresh(*(Region(left + start, top + row, end - start, 1) for row, start, end in spans))


def _fit(
    source: Source | None,
    columns: int,
    rows: int,
    aids: Sequence[Aid],
    palette: Palette,
    *,
    light: bool,
) -> CellPicture | None:
    loaded = source() if callable(source) else source
    image = decode_image(loaded, colour=True) if isinstance(loaded, bytes) else loaded
    if image is None or not image.size:
        return None
    across, down = fitted_cells(image.shape[1], image.shape[0], columns, rows)
    width, height = across * palette.pixels[0], down * palette.pixels[1]
    scaled = resample(np.ascontiguousarray(image), width, height)
    return draw_cells(paint_marks(scaled, image, aids), palette, light=light)
