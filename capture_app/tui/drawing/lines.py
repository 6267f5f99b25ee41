"""Lines of text on the screen of which only the cells that differ are sent to the terminal."""

from collections.abc import Sequence

from rich.segment import Segment
from textual.content import Content
from textual.geometry import Region, Size
from textual.strip import Strip
from textual.widget import Widget

from capture_app.tui.drawing.line_parts import strip_of_line


class Lines(Widget):
    """Shows styled lines, cut with an ellipsis at its width; as high as they are where its height is auto."""

    DEFAULT_CSS = "Lines { height: auto; }"

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self._lines: tuple[Content, ...] = ()
        self._strips: list[Strip] = []

    @property
    def plain(self) -> tuple[str, ...]:
        """The lines without their style."""
        return tuple(line.plain for line in self._lines)

    def show(self, lines: Sequence[Content]) -> None:
        """Show these lines instead, and redraw the cells that differ."""
        before = self._strips
        self._lines = tuple(lines)
        if not self.is_attached:
            return
        self._strips = [strip_of_line(self, line) for line in lines]
        if len(before) != len(self._strips):
            self.refresh(layout=True)
            return
        regions = [
            Region(span[0], y, span[1] - span[0], 1)
            for y, (old, new) in enumerate(zip(before, self._strips, strict=True))
            if (span := _difference(old, new))
        ]
        if regions:
            self.refresh(*regions)

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """As many as there are lines."""
        return len(self._lines)

    def get_content_width(self, container: Size, viewport: Size) -> int:
        """As wide as the widest line."""
        return max((line.cell_length for line in self._lines), default=0)

    def render_line(self, y: int) -> Strip:
        """The line as it was drawn when it was shown."""
        if y >= len(self._strips):
            return Strip.blank(self.size.width, self.rich_style)
        strip, width = self._strips[y], self.size.width
        if strip.cell_length > width > 1 and strip.text[width - 1 :].strip():
            kept = strip.crop(0, width - 1)
            strip = Strip([*kept, Segment("…", list(kept)[-1].style)])
        return strip.adjust_cell_length(width, self.rich_style)

    def on_mount(self) -> None:
        """Draw what was shown before there was a place for it."""
        self._draw_anew()

    def notify_style_update(self) -> None:
        """Draw anew: the colours have changed."""
        super().notify_style_update()
        self._draw_anew()

    def _draw_anew(self) -> None:
        if self.is_attached:
            self._strips = [strip_of_line(self, line) for line in self._lines]
            self.refresh(layout=True)


def _difference(old: Strip, new: Strip) -> tuple[int, int] | None:
    """The first cell that differs, and the one after the last; None where none does."""
    if old == new:
        return None
    before, after = _cells(old), _cells(new)
    if len(before) != len(after):
        return 0, max(len(before), len(after), 1)
    differing = [x for x, (one, other) in enumerate(zip(before, after, strict=True)) if one != other]
    return (differing[0], differing[-1] + 1) if differing else None


def _cells(strip: Strip) -> list[tuple[str, object]]:
    cells: list[tuple[str, object]] = []
    for text, style, _ in strip:
        for character in text:
            # A wide character is one entry for two cells: a strip with one is compared by its entries.
            cells.append((character, style))
    return cells if len(cells) == strip.cell_length else [(strip.text, tuple(strip))]
