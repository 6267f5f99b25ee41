"""A widget that shows an image fitted into its cells."""

import asyncio
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from rich.segment import Segment
from rich.style import Style
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
from capture_app.tui.pictures.sharp import SharpPicture, SharpTerminal, sharp_terminal_of

Source: TypeAlias = bytes | Image | Callable[[], "bytes | Image | None"]
"""An image file's bytes, pixels (BGR or grey), or what loads one of these, called in a thread."""

NOISE = 12
"""Colours (of 255) by which a cell of a live picture may differ from what is shown and is not sent again.

A sensor's noise would else have nearly all sent each time: a third of the bytes
(`benchmarks/screen/previews.py`).
"""

REST_S = 0.2
"""How long a picture rests before it is sent in pixels: who leafs through a take wants none."""


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
        self._sharp_source: Source | None = None
        self._sharp: SharpPicture | None = None
        self._sharpening = False
        self._turn = 0
        """Counts what was asked for, so that what is done too late is known."""
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

    def show(self, source: Source | None, words: str | None = None, *, sharp: Source | None = None) -> None:
        """Show this image instead; nothing happens where it is the same.

        `sharp`: the same with more pixels, which take the glyphs' place where the terminal can show them.
        """
        if words is not None and printable(words) != self._words:
            self._words = printable(words)
            self.refresh()
        same = source is self._source or (isinstance(source, bytes) and source == self._source)
        if same and sharp is self._sharp_source:
            return
        self._source, self._sharp_source = source, sharp
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

    def on_unmount(self) -> None:
        """Leave nothing in the terminal."""
        self._put_sharp(None)

    def render_line(self, y: int) -> Strip:
        """One line of the picture."""
        width, plain = self.size.width, self.rich_style
        cells = self._sharp or self._cells
        if cells is None:
            words = self._words if y == self.size.height // 2 else ""
            return Strip([Segment(words[:width].center(width), plain)], width)
        row = y - (self.size.height - cells.rows) // 2
        if not 0 <= row < cells.rows or cells.columns > width:
            return Strip.blank(width, plain)
        left = (width - cells.columns) // 2
        strips = [Strip.blank(left, plain), _strip(cells, row, plain)]
        return Strip.join([*strips, Strip.blank(width - left - cells.columns, plain)])

    def _draw_again(self) -> None:
        self._stale = True
        self._turn += 1
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
        if not self._sharpening and self._sharp_source is not None:
            self._sharpening = True
            self._sharpen()

    @work
    async def _sharpen(self) -> None:
        """Have pixels take the glyphs' place, unless another picture is wanted meanwhile."""
        try:
            while self._sharp is None and self.size:
                terminal, source, turn = sharp_terminal_of(self.app), self._sharp_source, self._turn
                if terminal is None or source is None:
                    return
                await asyncio.sleep(REST_S)
                if turn != self._turn:
                    continue
                sent = await asyncio.to_thread(_send, terminal, source, self.size.width, self.size.height)
                if sent is None:
                    return
                if turn == self._turn:
                    self._put_sharp(sent)
                else:
                    sent.forget()
        finally:
            self._sharpening = False

    def _put(self, new: CellPicture | None) -> None:
        was_sharp = self._put_sharp(None)
        shown = None if was_sharp else self._cells
        if shown is not None and new is not None:
            new = keep_what_looks_alike(shown, new, self._noise)
        self._cells = new
        spans = None if shown is None or new is None else changed_spans(shown, new)
        if spans is None or new is None:
            self.refresh()
        elif spans:
            left, top = (self.size.width - new.columns) // 2, (self.size.height - new.rows) // 2
            self.refresh(*(Region(left + start, top + row, end - start, 1) for row, start, end in spans))

    def _put_sharp(self, new: SharpPicture | None) -> bool:
        """Show this instead of glyphs, or glyphs again; returns whether another had been there."""
        old, self._sharp = self._sharp, new
        if old is not None:
            old.forget()
        if new is not None:
            self.refresh()
        return old is not None


def _strip(cells: CellPicture | SharpPicture, row: int, plain: Style) -> Strip:
    return cells.strip(row) if isinstance(cells, SharpPicture) else strip_of(cells, row, plain)


def _load(source: Source | None) -> Image | None:
    loaded = source() if callable(source) else source
    image = decode_image(loaded, colour=True) if isinstance(loaded, bytes) else loaded
    return None if image is None or not image.size else image


def _send(terminal: SharpTerminal, source: Source, columns: int, rows: int) -> SharpPicture | None:
    image = _load(source)
    return None if image is None else terminal.send(image, columns, rows)


def _fit(
    source: Source | None,
    columns: int,
    rows: int,
    aids: Sequence[Aid],
    palette: Palette,
    *,
    light: bool,
) -> CellPicture | None:
    image = _load(source)
    if image is None:
        return None
    across, down = fitted_cells(image.shape[1], image.shape[0], columns, rows)
    width, height = across * palette.pixels[0], down * palette.pixels[1]
    scaled = resample(np.ascontiguousarray(image), width, height)
    return draw_cells(paint_marks(scaled, image, aids), palette, light=light)
