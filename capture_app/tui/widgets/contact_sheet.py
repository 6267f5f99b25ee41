"""Contact sheet of a take: cameras across, instants down, as large as the space allows."""

from functools import partial
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual import events, work
from textual.binding import Binding, BindingType
from textual.geometry import Offset, Region, Size
from textual.scroll_view import ScrollView
from textual.strip import Strip

from capture_app.common.text import duration, printable
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.widgets.cells import CellPicture
from capture_app.tui.widgets.look import LookScreen, Motion
from capture_app.tui.widgets.picture import draw_for, strip_of_middle

GUTTER = 9
"""Columns for an instant's time."""
MIN_WIDTH, MAX_WIDTH = 10, 60
"""Min and max columns of a picture."""


class ContactSheet(ScrollView, can_focus=True):
    """Grid of all pictures of a take; the cursor selects one, Enter opens it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "move(-1,0)", "Camera before", id="sheet.left", show=False),
        Binding("right", "move(1,0)", "Camera after", id="sheet.right", show=False),
        Binding("up", "move(0,-1)", "Instant before", id="sheet.up", show=False),
        Binding("down", "move(0,1)", "Instant after", id="sheet.down", show=False),
        Binding("pageup", "move(0,-4)", "Four instants before", id="sheet.page-up", show=False),
        Binding("pagedown", "move(0,4)", "Four instants after", id="sheet.page-down", show=False),
        Binding("enter", "look", "Open picture", id="sheet.open"),
        Binding("b", "look('cameras')", "Blink", id="take.blink", tooltip="alternate two cameras"),
        Binding(
            "w", "look('wiggle')", "Wiggle", id="shoot.wiggle", tooltip="back and forth through the cameras"
        ),
        Binding(
            "P",
            "look('play')",
            "Play",
            show=False,
            id="take.play",
            tooltip="all instants, one after the other",
        ),
        Binding("plus,equals_sign", "zoom(1.3)", "Larger", id="sheet.larger", show=False, key_display="+"),
        Binding("minus", "zoom(0.77)", "Smaller", id="sheet.smaller", show=False, key_display="-"),
    ]
    COMPONENT_CLASSES: ClassVar[set[str]] = {
        "sheet--label",
        "sheet--cursor",
        "sheet--frame",
        "sheet--note",
        "sheet--empty",
    }
    DEFAULT_CSS = """
    ContactSheet {
        height: 1fr; width: 1fr; scrollbar-size: 1 1;
        & > .sheet--label { color: $text-muted; }
        & > .sheet--cursor { color: $primary; text-style: bold reverse; }
        & > .sheet--frame { color: $primary; }
        & > .sheet--note { color: $warning; }
        & > .sheet--empty { color: $text-muted; background: $surface; }
    }
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.sheet: TakeSheet | None = None
        self.cursor = Offset(0, 0)
        """Indices of camera and instant."""
        self._thumbs: dict[tuple[int, int], CellPicture | None] = {}
        self._missing_thumbs: list[tuple[int, int]] = []
        """Visible pictures that are not drawn yet."""
        self._zoom = 1.0
        self._plain = Style()
        """The widget's style while a line is drawn: Textual computes it anew at each look."""

    def show(self, sheet: TakeSheet | None) -> None:
        """Show another take from its first picture."""
        self.sheet, self.cursor, self._zoom = sheet, Offset(0, 0), 1.0
        self.scroll_to(0, 0, animate=False)
        self._lay_out()

    @property
    def thumb_size(self) -> Size:
        """Columns and rows of a picture."""
        sheet, room = self.sheet, self.size
        if sheet is None:
            return Size(0, 0)
        wide = (room.width - GUTTER) // max(1, len(sheet.cameras)) - 1
        # With few instants, large pictures must leave space for another row.
        high = int((room.height - 1) * 2 / max(2, min(sheet.instants, 3)) / sheet.aspect)
        fit = max(min(wide, high, MAX_WIDTH), MIN_WIDTH)
        width = round(min(fit * self._zoom, 4 * MAX_WIDTH, room.width - GUTTER))
        rows = max(2, round(width * sheet.aspect / 2))
        return Size(max(4, min(width, round(2 * rows / sheet.aspect))), rows)

    def go_to(self, camera: str, instant: int) -> None:
        """Move the cursor to a picture."""
        if self.sheet is not None and camera in self.sheet.cameras:
            self._put_cursor(self.sheet.cameras.index(camera), instant)

    def action_move(self, cameras: int, instants: int) -> None:
        """Move the cursor."""
        self._put_cursor(self.cursor.x + cameras, self.cursor.y + instants)

    def action_look(self, motion: Motion = "still") -> None:
        """Open the selected picture, still or in motion; the cursor then moves to the last one seen."""
        if self.sheet is not None and self.sheet.cameras and self.sheet.instants:
            look = LookScreen(self.sheet, self.sheet.cameras[self.cursor.x], self.cursor.y, motion)
            self.app.push_screen(look, lambda seen: None if seen is None else self.go_to(*seen))

    def action_zoom(self, factor: float) -> None:
        """Enlarge or shrink the pictures."""
        self._zoom = min(max(self._zoom * factor, 0.3), 6.0)
        self._lay_out()
        self._scroll_to_cursor()

    def on_click(self, event: events.Click) -> None:
        """Select a picture; a click on the selected one opens it."""
        if self.sheet is None or event.y < 1 or event.x < GUTTER:
            return
        size = self.thumb_size
        at = Offset(
            int(event.x - GUTTER + self.scroll_offset.x) // (size.width + 1),
            int(event.y - 1 + self.scroll_offset.y) // (size.height + 1),
        )
        if at.x < len(self.sheet.cameras) and at.y < self.sheet.instants:
            opens = at == self.cursor
            self._put_cursor(*at)
            if opens:
                self.action_look()

    def render_line(self, y: int) -> Strip:
        """Return one line: the cameras' names, or a line of pictures and of the notes below them."""
        width, sheet = self.size.width, self.sheet
        plain = self._plain = self.rich_style
        if sheet is None:
            return Strip.blank(width, plain)
        size, left = self.thumb_size, self.scroll_offset.x
        first, beyond = divmod(left, size.width + 1)
        room = width - GUTTER
        cameras = range(first, min(first + room // (size.width + 1) + 2, len(sheet.cameras)))
        if y == 0:
            gutter, content = self._words(" instant", GUTTER, "sheet--label"), self._names(sheet, cameras)
        else:
            instant, line = divmod(y - 1 + self.scroll_offset.y, size.height + 1)
            if instant >= sheet.instants:
                return Strip.blank(width, plain)
            gutter, content = self._gutter(sheet, instant, line), self._row(sheet, cameras, instant, line)
        return Strip.join([gutter, content.crop(beyond, beyond + room)]).adjust_cell_length(width, plain)

    def _lay_out(self) -> None:
        self._thumbs.clear()
        self._missing_thumbs.clear()
        if self.sheet is not None:
            size = self.thumb_size
            self.virtual_size = Size(
                GUTTER + len(self.sheet.cameras) * (size.width + 1),
                1 + self.sheet.instants * (size.height + 1),
            )
        self.refresh()

    on_resize = _lay_out

    def _names(self, sheet: TakeSheet, cameras: range) -> Strip:
        labels = sheet.session.stored_manifest.labels
        return Strip.join(
            self._words(
                printable(labels[sheet.cameras[at]]),
                self.thumb_size.width + 1,
                "sheet--cursor" if at == self.cursor.x else "sheet--label",
                gap=1,
            )
            for at in cameras
        )

    def _gutter(self, sheet: TakeSheet, instant: int, line: int) -> Strip:
        if line == 0:
            style = "sheet--cursor" if instant == self.cursor.y else "sheet--label"
            text = duration(sheet.since_start_ns(instant), signed=True) if instant else "first"
            gutter = self._words(text.rjust(GUTTER - 1), GUTTER, style, gap=1)
        elif line == 1 and (scatter := sheet.spread_ns(instant)) is not None:
            gutter = self._words(f"↔{duration(scatter)}".rjust(GUTTER - 1), GUTTER, "sheet--label", gap=1)
        else:
            gutter = Strip.blank(GUTTER, self._plain)
        if self.cursor == (0, instant) and line < self.thumb_size.height:
            gutter = Strip.join([gutter.crop(0, GUTTER - 1), self._words("▐", 1, "sheet--frame")])
        return gutter

    def _row(self, sheet: TakeSheet, cameras: range, instant: int, line: int) -> Strip:
        size, parts = self.thumb_size, []
        for at in cameras:
            here = self.cursor == (at, instant)
            if line < size.height:
                parts.append(self._thumb_line(at, instant, line))
            else:
                text, style = ("▀" * size.width, "sheet--frame") if here else ("", "sheet--label")
                if note := sheet.note(sheet.cameras[at], instant):
                    text, style = f"! {printable(note)}", "sheet--note"
                parts.append(self._words(text, size.width, style))
            edge = "▌" if here else "▐" if self.cursor == (at + 1, instant) else " "
            parts.append(self._words(edge if line < size.height else " ", 1, "sheet--frame"))
        return Strip.join(parts)

    def _thumb_line(self, at: int, instant: int, line: int) -> Strip:
        size = self.thumb_size
        thumb = self._thumbs.get((at, instant))
        if thumb is None:
            known = (at, instant) in self._thumbs
            if not known and (at, instant) not in self._missing_thumbs:
                self._missing_thumbs.append((at, instant))
                if len(self._missing_thumbs) == 1:
                    self._load()
            text = ("no picture" if known else "loading …") if line == size.height // 2 else ""
            return self._words(text.center(size.width), size.width, "sheet--empty")
        return strip_of_middle(thumb, line, size, self._plain, self.get_component_rich_style("sheet--empty"))

    def _words(self, text: str, width: int, style: str, *, gap: int = 0) -> Strip:
        look: Style = self.get_component_rich_style(style)
        room = width - gap
        cut = Strip([Segment(text if len(text) <= room else text[: room - 1] + "…", look)])
        return Strip.join([cut, Strip.blank(gap, self._plain)]).adjust_cell_length(width, self._plain)

    def _put_cursor(self, x: int, y: int) -> None:
        if self.sheet is None or not self.sheet.cameras or not self.sheet.instants:
            return
        at = Offset(min(max(x, 0), len(self.sheet.cameras) - 1), min(max(y, 0), self.sheet.instants - 1))
        if at != self.cursor:
            before, self.cursor = self.cursor, at
            for place in (before, at):
                region = self._region(place.x, place.y)
                self._refresh_region(Region(region.x - 1, region.y, region.width + 2, region.height + 1))
                self._refresh_region(Region(0, region.y, GUTTER, 1), scrolls_sideways=False)
            self.refresh(Region(0, 0, self.size.width, 1))
            self._scroll_to_cursor()

    def _scroll_to_cursor(self) -> None:
        size = self.thumb_size
        x, y = self.cursor.x * (size.width + 1), self.cursor.y * (size.height + 1)
        room = Size(self.size.width - GUTTER, self.size.height - 1)
        left, top = self.scroll_offset
        left = min(x, max(left, x + size.width + 1 - room.width))
        top = min(y, max(top, y + size.height + 1 - room.height))
        self.scroll_to(left, top, animate=False)

    def _region(self, x: int, y: int) -> Region:
        """Return a picture's region in the whole sheet."""
        size = self.thumb_size
        return Region(GUTTER + x * (size.width + 1), 1 + y * (size.height + 1), *size)

    def _refresh_region(self, region: Region, *, scrolls_sideways: bool = True) -> None:
        left = self.scroll_offset.x if scrolls_sideways else 0
        if seen := region.translate((-left, -self.scroll_offset.y)).intersection(self.size.region):
            self.refresh(seen)

    @work(exclusive=True, group="thumbs")
    async def _load(self) -> None:
        """Draw newly visible pictures one by one in a thread."""
        sheet, size = self.sheet, self.thumb_size
        while sheet is not None and self._missing_thumbs:
            x, y = self._missing_thumbs[0]
            drawn = await draw_for(self.app, partial(sheet.load, sheet.cameras[x], y, 2 * size.width), size)
            if (x, y) in self._missing_thumbs and sheet is self.sheet:
                self._missing_thumbs.remove((x, y))
                self._thumbs[x, y] = drawn
                self._refresh_region(self._region(x, y))
