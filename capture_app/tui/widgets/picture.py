"""Widget that shows an image in cells, or in the terminal's own pixels if supported.

Pixels require textual-image and kitty's protocol with Unicode placeholders. Such pictures are text cells,
which menus can cover, whereas sixels are painted over any content. WezTerm and Konsole claim the protocol but
lack placeholders; they are recognized by their sixel support.
"""

import asyncio
import importlib
import io
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, TypeAlias

import cv2
import numpy as np
from rich.console import Console
from rich.segment import Segment
from rich.style import Style
from textual import work
from textual.app import App
from textual.geometry import Region, Size
from textual.reactive import reactive
from textual.strip import Strip
from textual.widget import Widget

from capture_app.common.text import printable
from capture_app.session.reading.decoding import decode_preview
from capture_app.tui.widgets.cells import (
    CellPicture,
    Image,
    Palette,
    changed_spans,
    draw_cells,
    fitted_cells,
    keep_equal_cells,
    palette_of,
    resample,
)
from capture_app.tui.widgets.focus_aids import Aid, paint_marks
from capture_app.tui.widgets.painted import PaintedStrip, blank_code

MAX_CELLS = 297
"""Max columns or rows that a placeholder can address."""
NOISE = 12
"""Max colour difference (8-bit levels) at which a cell of a live picture is not sent again.

Without it, sensor noise would change nearly all cells each time; it reduced the bytes sent to a third.
"""
REST_S = 0.2
"""Delay before a picture is sent in pixels, in seconds; browsing through a take sends none."""

ANSWER_S = 1.0
"""Max delay of a terminal's answers at the start, in seconds; textual-image waits a tenth of it."""


class SharpTerminal:
    """Sender of pictures to a terminal with kitty's protocol."""

    def __init__(self, picture: type[Any], cell: tuple[int, int]) -> None:
        """`picture`: textual-image's renderable; `cell`: width and height of a cell in pixels."""
        self._picture, self._cell = picture, cell

    def width_px(self, columns: int) -> int:
        """Return the width of `columns` cells in pixels."""
        return min(columns, MAX_CELLS) * self._cell[0]

    def send(self, image: Image, columns: int, rows: int) -> "SharpPicture":
        """Send an image fitted into this space. Takes a second; call in a thread."""
        height, width = image.shape[:2]
        across, down = fitted_cells(width, height, min(columns, MAX_CELLS), min(rows, MAX_CELLS))
        scaled = resample(np.ascontiguousarray(image), across * self._cell[0], down * self._cell[1])
        rgb = cv2.cvtColor(scaled, cv2.COLOR_GRAY2RGB if scaled.ndim == 2 else cv2.COLOR_BGR2RGB)
        sent = self._picture(importlib.import_module("PIL.Image").fromarray(rgb), across, down)
        return SharpPicture(sent, across, down)


class SharpPicture:
    """Picture in full resolution, stored in a terminal that can show images, and its placeholder cells."""

    def __init__(self, sent: Any, columns: int, rows: int) -> None:
        console = Console(width=columns, height=rows, file=io.StringIO(), color_system="truecolor")
        self._sent = sent
        self._lines = [list(line) for line in Segment.split_lines(console.render(sent))]
        self.size = Size(columns, rows)

    def strip(self, row: int, _plain: Style) -> Strip:
        """Return a row of placeholder cells."""
        return Strip(self._lines[row], self.size.width)

    def forget(self) -> None:
        """Delete the picture from the terminal."""
        self._sent.cleanup()


def strip_of_middle(
    drawn: CellPicture | SharpPicture, line: int, size: Size, plain: Style, around: Style
) -> Strip:
    """Return line `line` of a box of `size` cells that has the picture in its centre.

    `plain` is the style of a picture without colours, `around` that of the margin.
    """
    row, margin = line - (size.height - drawn.size.height) // 2, size.width - drawn.size.width
    left, right = margin // 2, (margin + 1) // 2
    if not 0 <= row < drawn.size.height or left < 0:
        return Strip.blank(size.width, around)
    return Strip.join([Strip.blank(left, around), drawn.strip(row, plain), Strip.blank(right, around)])


def find_sharp_terminal(choice: str, environment: Mapping[str, str] = os.environ) -> SharpTerminal | None:
    """Return the sender of pixel pictures, or None if only glyphs are available.

    `choice`: "glyphs" disables pixels; "sharp" allows them over SSH too, where megabytes per picture may be
    slow; any other value allows them locally.

    Call it before the screen starts: importing textual-image queries the terminal on standard input.
    """
    remote = choice != "sharp" and bool(environment.keys() & {"SSH_CONNECTION", "SSH_TTY"})
    if (
        choice == "glyphs"
        or remote
        or not all(end is not None and end.isatty() for end in (sys.__stdin__, sys.__stdout__))
    ):
        return None
    try:
        found = importlib.import_module("textual_image.renderable")
        _discard_late_answers()
        if found.Image is not found.TGPImage:
            return None
        cell = importlib.import_module("textual_image._terminal").get_cell_size()
    except Exception:  # noqa: BLE001 - any failure of an optional package falls back to glyphs
        return None
    return SharpTerminal(found.TGPImage, (cell.width, cell.height))


def _discard_late_answers() -> None:
    """Read and discard the answers for which textual-image did not wait: the app would take them as keys.

    A terminal answers in order, so nothing is outstanding after the answer to this last query.
    """
    terminal = importlib.import_module("textual_image._terminal")
    answers = ""
    with suppress(TimeoutError), terminal.capture_mode():
        os.write(1, b"\x1b[5n")
        while not answers.endswith("\x1b[0n"):
            answers += terminal.read(0, 1, ANSWER_S)


def sharp_terminal_of(app: App[Any]) -> SharpTerminal | None:
    """Return an app's sender of pixel pictures, in full colour only: colours encode the picture's id."""
    return getattr(app, "sharp_terminal", None) if palette_of(app) is Palette.TRUECOLOR else None


Source: TypeAlias = bytes | Image | Callable[[], "bytes | Image | None"]
"""Bytes of an image file, pixels (BGR or grey), or a function that loads either, called in a thread."""


class Picture(Widget):
    """Image as large as fits at its aspect ratio; without one, `words` are shown."""

    DEFAULT_CSS = "Picture { width: 1fr; height: 1fr; }"
    is_grey: reactive[bool] = reactive(False)
    """Whether it is shown without its colours."""
    is_faded: reactive[bool] = reactive(False)
    """Whether it is shown half in the colour of its background."""

    def __init__(
        self,
        *,
        words: str = "",
        noise: int = 0,
        id: str | None = None,
    ) -> None:
        """`noise`: max difference of cells that are left unchanged, see NOISE."""
        super().__init__(id=id)
        self._source: Source | None = None
        self._noise = noise
        self._words = printable(words)
        self._aids: tuple[Aid, ...] = ()
        self.cells: CellPicture | None = None
        """Cells on display."""
        self._sharp_source: Source | None = None
        self._sharp: SharpPicture | None = None
        self._request = 0
        """Counter of requests, which identifies outdated work."""
        self._drawing = False

    def show(self, source: Source | None, words: str | None = None, *, sharp: Source | None = None) -> None:
        """Show this image, unless it is already shown.

        `sharp`: the image at higher resolution, which replaces the glyphs if the terminal supports it.
        """
        if words is not None and printable(words) != self._words:
            self._words = printable(words)
            self.refresh()
        same = source is self._source or (isinstance(source, bytes) and source == self._source)
        if same and sharp is self._sharp_source:
            return
        self._source, self._sharp_source = source, sharp
        self._draw_again()

    def show_drawn(self, source: Source, cells: CellPicture | None, size: Size) -> None:
        """Show this image, whose cells were drawn for a box of `size`; draw it again if that has changed."""
        self._source, self._sharp_source = source, None
        self._request += 1
        if size == self.size:
            self._put(cells)
        else:
            self._draw_again()

    def show_aids(self, aids: Sequence[Aid]) -> None:
        """Mark parts of the picture with these aids."""
        if tuple(aids) != self._aids:
            self._aids = tuple(aids)
            self._draw_again()

    def on_mount(self) -> None:
        """Redraw on a theme change, because dots are dark on a light theme."""
        self.app.theme_changed_signal.subscribe(self, lambda _: self._draw_again())

    def on_unmount(self) -> None:
        """Delete the picture from the terminal."""
        self._put_sharp(None)

    def render_lines(self, crop: Region) -> list[Strip]:
        """Return lines of the picture, in true colours past Textual's objects for each colour."""
        box, cells = self.size.region, None if self._sharp else self._toned
        fits = cells is not None and crop == box and box.contains_region(cells.size.region)
        if cells is None or not fits or cells.palette is not Palette.TRUECOLOR:
            return super().render_lines(crop)
        painted = np.tile(blank_code(self.rich_style), (box.height, box.width, 1))
        left, top = (box.width - cells.size.width) // 2, (box.height - cells.size.height) // 2
        painted[top : top + cells.size.height, left : left + cells.size.width] = cells.codes
        return [PaintedStrip(codes, partial(self.render_line, y)) for y, codes in enumerate(painted)]

    def render_line(self, y: int) -> Strip:
        """Return one line of the picture."""
        width, plain = self.size.width, self.rich_style
        if (drawn := self._sharp or self._toned) is not None:
            return strip_of_middle(drawn, y, self.size, plain, plain)
        words = self._words[:width] if y == self.size.height // 2 else ""
        return Strip([Segment(words.center(width), plain)], width)

    @property
    def _toned(self) -> CellPicture | None:
        faded_to = self.background_colors[1].rgb if self.is_faded else None
        return None if self.cells is None else self.cells.toned(is_grey=self.is_grey, faded_to=faded_to)

    def _draw_again(self) -> None:
        self._request += 1
        if not self._drawing and self.is_mounted and self.size:
            self._drawing = True
            self._draw()

    on_resize = _draw_again

    @work
    async def _draw(self) -> None:
        """Draw the newest image until no newer one is waiting; intermediate ones are skipped."""
        drawn = 0
        try:
            while drawn != self._request and self.size:
                drawn = self._request
                self._put(await draw_for(self.app, self._source, self.size, self._aids))
        finally:
            self._drawing = False
        if self._sharp_source is not None:
            self._sharpen(self._sharp_source, self._request)

    @work
    async def _sharpen(self, source: Source, request: int) -> None:
        """Replace the glyphs by pixels, unless another picture is requested meanwhile."""
        await asyncio.sleep(REST_S)
        terminal = sharp_terminal_of(self.app)
        if terminal is None or request != self._request or not self.size:
            return
        sent = await asyncio.to_thread(_send, terminal, source, *self.size)
        if sent is not None and request == self._request:
            self._put_sharp(sent)
        elif sent is not None:
            sent.forget()

    def _put(self, new: CellPicture | None) -> None:
        shown = None if self._put_sharp(None) else self.cells
        if shown is not None and new is not None:
            new = keep_equal_cells(shown, new, self._noise)
        self.cells = new
        spans = None if shown is None or new is None else changed_spans(shown, new)
        if spans is None or new is None:
            self.refresh()
        elif spans:
            left, top = (self.size.width - new.size.width) // 2, (self.size.height - new.size.height) // 2
            self.refresh(*(Region(left + start, top + row, end - start, 1) for row, start, end in spans))

    def _put_sharp(self, new: SharpPicture | None) -> bool:
        """Show a pixel picture, or glyphs for None; return whether another one was replaced."""
        old, self._sharp = self._sharp, new
        if old is not None:
            old.forget()
        if new is not None:
            self.refresh()
        return old is not None


def _load(source: Source | None) -> Image | None:
    loaded = source() if callable(source) else source
    if isinstance(loaded, bytes):
        loaded = decode_preview(loaded)
    return None if loaded is None or not loaded.size else loaded


def _send(terminal: SharpTerminal, source: Source, columns: int, rows: int) -> SharpPicture | None:
    image = _load(source)
    return None if image is None else terminal.send(image, columns, rows)


async def draw_for(
    app: App[Any], source: Source | None, size: Size, aids: Sequence[Aid] = ()
) -> CellPicture | None:
    """Draw an image for an app's terminal, as large as fits into `size`, in a thread; None without image."""
    return await asyncio.to_thread(
        _fit, source, size, aids, palette_of(app), light=not app.current_theme.dark
    )


def _fit(
    source: Source | None, size: Size, aids: Sequence[Aid], palette: Palette, *, light: bool
) -> CellPicture | None:
    image = _load(source)
    if image is None:
        return None
    across, down = fitted_cells(image.shape[1], image.shape[0], *size)
    scaled = resample(np.ascontiguousarray(image), across * palette.pixels[0], down * palette.pixels[1])
    return draw_cells(paint_marks(scaled, image, aids), palette, light=light)
