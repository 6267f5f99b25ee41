"""List of rows with a cursor; rows are drawn when they become visible, and again when they change."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

from textual import events
from textual.binding import Binding, BindingType
from textual.content import Content
from textual.geometry import Region, Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.strip import Strip

from capture_app.tui.widgets.lines import changed_cells, strip_of_line

Item = TypeVar("Item")


class RowList(ScrollView, Generic[Item], can_focus=True):
    """List of items in rows of equal height."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "move(-1)", "Row above", show=False, id="list.up"),
        Binding("down,j", "move(1)", "Row below", show=False, id="list.down"),
        Binding("pageup", "page(-1)", "Page up", show=False, id="list.page-up"),
        Binding("pagedown", "page(1)", "Page down", show=False, id="list.page-down"),
        Binding("home", "move(-99999)", "First row", show=False, id="list.first"),
        Binding("end", "move(99999)", "Last row", show=False, id="list.last"),
    ]

    @dataclass
    class Chosen(Message):
        """Message: another row is selected, or none is."""

        opens: bool = False
        """Whether the row was double-clicked; the view defines keys that open a row."""

    def __init__(
        self,
        row_height: int,
        draw_row: Callable[[Item, int, bool], Sequence[Content | Strip]],
        *,
        id: str | None = None,
    ) -> None:
        """`draw_row` returns the `row_height` lines of an item, from its width and whether it is selected."""
        super().__init__(id=id)
        self.row_height, self._draw_row = row_height, draw_row
        self.items: dict[str, Item] = {}
        """Items on display, by key."""
        self.keys: tuple[str, ...] = ()
        """Keys in the order of the rows."""
        self._at = 0
        self._drawn: dict[str, list[Strip]] = {}

    # Methods for the view

    @property
    def chosen(self) -> str:
        """Key of the selected row; empty if there are no rows."""
        return self.keys[self._at] if self.keys else ""

    @property
    def item(self) -> Item | None:
        """Selected item."""
        return self.items.get(self.chosen)

    def show_items(self, items: Mapping[str, Item], row_height: int = 0) -> None:
        """Show these items by key; the cursor stays on its row, or at its position if the row is removed.

        `row_height`: another height of the rows than until now.
        """
        before, self.items = self.chosen, dict(items)
        if row_height not in (0, self.row_height):
            self.row_height = row_height
            self._draw_anew()
        if tuple(items) != self.keys:
            self.keys = tuple(items)
            self._at = self.keys.index(before) if before in self.keys else self._at
            self._at = max(0, min(self._at, len(self.keys) - 1))
            self._drawn.clear()
            self._fit()
            self.refresh()
        self.show_all_again()
        if self.chosen != before or not before:
            self.post_message(self.Chosen())

    def show_again(self, key: str) -> None:
        """Redraw a row that has changed."""
        old = self._drawn.pop(key, None)
        if old is None or key not in self.keys or not self.is_attached:
            return
        top = self.keys.index(key) * self.row_height - self.scroll_offset.y
        for line, (one, other) in enumerate(zip(old, self._lines(key), strict=True)):
            begin, end = changed_cells(one, other)
            if seen := Region(begin, top + line, end - begin, 1).intersection(self.size.region):
                self.refresh(seen)

    def show_all_again(self) -> None:
        """Redraw the visible rows; others are drawn when they become visible."""
        first, room = self.scroll_offset.y // self.row_height, self.size.height // self.row_height
        seen = self.keys[first : first + room + 2]
        self._drawn = {key: lines for key, lines in self._drawn.items() if key in seen}
        for key in seen:
            self.show_again(key)

    def choose(self, key: str) -> None:
        """Select a row."""
        if key in self.keys:
            self._go(self.keys.index(key))

    # Keys and mouse

    def action_move(self, rows: int) -> None:
        """Move the cursor."""
        self._go(self._at + rows)

    def action_page(self, pages: int) -> None:
        """Move the cursor by pages."""
        self._go(self._at + pages * max(1, self.size.height // self.row_height))

    def on_click(self, event: events.Click) -> None:
        """Select the row that was clicked; a double click opens it."""
        at = (event.y + self.scroll_offset.y) // self.row_height
        if 0 <= at < len(self.keys):
            self._go(at)
            if event.chain == 2:
                self.post_message(self.Chosen(opens=True))

    # Drawing

    def notify_style_update(self) -> None:
        """Redraw in the new colours."""
        super().notify_style_update()
        self._draw_anew()

    def render_line(self, y: int) -> Strip:
        """Return line `y` of the widget: one line of one of the rows, or a blank line below them."""
        at, line = divmod(y + self.scroll_offset.y, self.row_height)
        is_row = 0 <= at < len(self.keys)
        return self._lines(self.keys[at])[line] if is_row else Strip.blank(self.size.width, self.rich_style)

    def _lines(self, key: str) -> list[Strip]:
        if key not in self._drawn:
            width, plain = self.scrollable_content_region.width, self.rich_style
            strips = (
                strip_of_line(self, line) if isinstance(line, Content) else line
                for line in self._draw_row(self.items[key], width, key == self.chosen)
            )
            self._drawn[key] = [strip.adjust_cell_length(width, plain) for strip in strips]
        return self._drawn[key]

    def _go(self, at: int) -> None:
        at = max(0, min(at, len(self.keys) - 1))
        if not self.keys:
            return
        if at != self._at:
            before, self._at = self.chosen, at
            self.show_again(before)
            self.show_again(self.chosen)
            self.post_message(self.Chosen())
        self._scroll_to_chosen()

    def _scroll_to_chosen(self) -> None:
        self.scroll_to_region(
            Region(0, self._at * self.row_height, 1, self.row_height), animate=False, x_axis=False
        )

    def _fit(self) -> None:
        self.virtual_size = Size(self.size.width, len(self.keys) * self.row_height)

    def _draw_anew(self) -> None:
        if self.is_attached:
            self._drawn.clear()
            self._fit()
            self.refresh()
            self.call_after_refresh(self._scroll_to_chosen)

    on_resize = _draw_anew
