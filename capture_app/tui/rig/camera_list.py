"""The list of cameras, one of them chosen: tall strips where there is room, else a line each."""

from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.content import Content
from textual.geometry import Region
from textual.message import Message

from capture_app.node.leader.snapshots import in_tree_order
from capture_app.node.wire.status import NodeStatus
from capture_app.text import count
from capture_app.tui.drawing.line_parts import chosen_line
from capture_app.tui.drawing.lines import Lines
from capture_app.tui.record import RigRecord, phases_at
from capture_app.tui.rig.camera_rows import (
    compact_head,
    compact_row,
    compact_strip_width,
    tall_rows,
    tall_strip_width,
)
from capture_app.tui.rig.phase_strip import SPAN_S, PhaseAxis, times_of
from capture_app.tui.states import cameras_of

HEIGHTS = (9, 7, 5, 3)
"""Rows of a camera in its tall form, the best first."""
BORDER = 2


class CameraList(Vertical, can_focus=True):
    """Shows what the record holds of each camera."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "move(-1)", "Previous camera", show=False, id="rig.previous"),
        Binding("down,j", "move(1)", "Next camera", show=False, id="rig.next"),
        Binding("pageup", "move(-5)", "Five cameras up", show=False, id="rig.page-up"),
        Binding("pagedown", "move(5)", "Five cameras down", show=False, id="rig.page-down"),
        Binding("home", "move(-9999)", "First camera", show=False, id="rig.first"),
        Binding("end", "move(9999)", "Last camera", show=False, id="rig.last"),
        Binding("enter", "open", "Look closely", id="rig.open", tooltip="its clock, phase and picture"),
    ]

    class Opened(Message):
        """The user wants to see a camera closely."""

        def __init__(self, name: str) -> None:
            super().__init__()
            self.name = name

    def __init__(self, record: RigRecord) -> None:
        super().__init__(id="cameras")
        self._record = record
        self._head = Lines(id="cameras-head")
        self._rows = Lines(id="cameras-rows")
        self._scroll = VerticalScroll(self._rows, id="cameras-scroll", can_focus=False)
        self._members: tuple[NodeStatus, ...] = ()
        self._chosen = ""
        self._height = 0
        """Rows of each camera; 1 for the compact form."""
        self._room = 0

    def compose(self) -> ComposeResult:
        """The titles of the columns stay where they are; the cameras scroll."""
        yield self._head
        yield self._scroll

    @property
    def chosen(self) -> NodeStatus | None:
        """The camera under the cursor."""
        return next((node for node in self._members if node.name == self._chosen), None)

    @staticmethod
    def rows_wanted(cameras: int, room: int) -> int:
        """How many rows the list takes, its border included, where it may have `room`."""
        height = _height_for(cameras, room - BORDER)
        return min(room, BORDER + (cameras * height if height > 1 else cameras + 1))

    def draw(self, room: int) -> None:
        """Show the record as it is now, in so many rows with the border."""
        self._room = room
        status = self._record.status
        width = self._scroll.scrollable_content_region.width
        if status is None or width <= 0:
            return
        self._members = tuple(in_tree_order(status.nodes))
        if self.chosen is None and self._members:
            self._chosen = self._members[0].name
        self._height = height = _height_for(len(self._members), room - BORDER)
        axis = PhaseAxis.of([node.tolerance_ns for node in self._members], status.period_ns)
        strip = tall_strip_width(width) if height > 1 else compact_strip_width(width)
        times = times_of(strip, self._record.clock())
        rows: list[Content] = []
        for node in self._members:
            errors = phases_at(self._record.phases.get(node.name, ()), times)
            if height > 1:
                lines = tall_rows(node, errors, axis, width=width, height=height)
            else:
                lines = [compact_row(node, errors, axis, width)]
            rows += [chosen_line(line, width) for line in lines] if node.name == self._chosen else lines
        self._head.show([compact_head(width)] if height == 1 else [])
        self._rows.show(rows)
        title = count(len(cameras_of(status)), "camera")
        subtitle = f"phase error over the last {SPAN_S:.0f} s · {axis}"
        if (title, subtitle) != (self.border_title, self.border_subtitle):  # setting them redraws all
            self.border_title, self.border_subtitle = title, subtitle

    def action_move(self, steps: int) -> None:
        """Choose another camera."""
        names = [node.name for node in self._members]
        if names:
            at = names.index(self._chosen) + steps
            self._choose(max(0, min(len(names) - 1, at)))

    def action_open(self) -> None:
        """Ask to see the chosen camera closely."""
        if self._chosen:
            self.post_message(self.Opened(self._chosen))

    def on_click(self, event: events.Click) -> None:
        """Choose the camera that was clicked; a second click opens it."""
        at = (event.screen_y - self._rows.region.y) // max(self._height, 1)
        if event.screen_y >= self._scroll.region.y and 0 <= at < len(self._members):
            self._choose(at)
            if event.chain == 2:
                self.action_open()

    def _choose(self, at: int) -> None:
        self._chosen = self._members[at].name
        self.draw(self._room)
        region = Region(0, at * self._height, 1, self._height)
        self._scroll.scroll_to_region(region, animate=False)


def _height_for(cameras: int, room: int) -> int:
    return next((height for height in HEIGHTS if cameras * height <= room), 1)
