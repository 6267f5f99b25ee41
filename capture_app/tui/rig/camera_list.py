"""List of cameras with a cursor: tall rows with a phase strip if space allows, else one line each."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content

from capture_app.common.camera_facts import SIMULATED
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.common.text import NO_VALUE, count, duration, printable
from capture_app.protocol.status import NodeStatus, in_tree_order
from capture_app.rig.rig_link import RigLink
from capture_app.tui.rig.camera_screen import CameraScreen
from capture_app.tui.rig_record import RigRecord, phases_at
from capture_app.tui.signs import SIGNS
from capture_app.tui.widgets.lines import Lines, chosen_line, write_border
from capture_app.tui.widgets.plots import AXIS_WIDTH, SPAN_S, PhaseAxis, strip_rows, times_of
from capture_app.tui.widgets.row_list import RowList

MIN_STRIP = 12
NAME_WIDTH = 12
BEFORE_STRIP = 3
"""Number of columns left of the strip."""
HEIGHTS = (9, 7, 5, 3)
"""Rows per camera in the tall form, best first."""
BORDER = 2
EQUAL_RATIO = 1.01
"""Ratio up to which two exposures or gains count as equal."""


@dataclass(frozen=True, slots=True)
class CameraColumn:
    """Column of the one-line form; `room` is the list width from which it is shown."""

    title: str
    width: int
    room: int = 0
    is_left: bool = False

    def fit(self, content: Content) -> Content:
        """Truncate or pad the cell's content to the column's width."""
        content = content.truncate(self.width, ellipsis=True, pad=self.is_left)
        return content.pad_left(self.width - content.cell_length)


COLUMNS = (
    CameraColumn("state", 13, is_left=True),
    CameraColumn("phase", 8),
    CameraColumn("error", 8),
    CameraColumn("fps", 5),
    CameraColumn("drops", 6),
    CameraColumn("exposure", 9, 100),
    CameraColumn("disk", 7, 110),
    CameraColumn("  model", 20, 140, is_left=True),
)


def compact_strip_width(width: int) -> int:
    """Return the strip's width in cells for a line of this width."""
    taken = 2 + NAME_WIDTH + sum(column.width for column in COLUMNS if width >= column.room)
    return max(width - taken - 3, MIN_STRIP)


def _compact(name: Content, cells: Mapping[str, Content], strip: Content, width: int) -> Content:
    parts = [name, *(c.fit(cells[c.title]) for c in COLUMNS if width >= c.room)]
    return Content("").join([*parts[: 1 + BEFORE_STRIP], strip, *parts[1 + BEFORE_STRIP :]])


def compact_head(width: int) -> Content:
    """Return the header of the one-line list: column titles, and the title of the phase plot."""
    room = compact_strip_width(width)
    strip = Content(f" {'phase over 30 s':<{room}.{room}} ")
    titles = {column.title: Content(column.title) for column in COLUMNS}
    return _compact(Content(f"  {'camera':<{NAME_WIDTH}}"), titles, strip, width).stylize("$foreground-muted")


def compact_row(node: NodeStatus, errors_ns: list[int | None], axis: PhaseAxis, width: int) -> Content:
    """Return a camera in one line; `errors_ns` has one value per cell of `compact_strip_width`."""
    lost = node.state is NodeState.LOST
    cells = {
        "state": _state(node),
        "phase": _phase(node, axis),
        "error": _time_error(node),
        "fps": Content(_fps(node)),
        "drops": Content.styled(str(node.drops), _drops_style(node)),
        "exposure": Content(_exposure(node)),
        "disk": Content(_disk(node)),
        "  model": Content(f"  {printable(node.camera.model)}"),
    }
    room = compact_strip_width(width)
    if any(error is not None for error in errors_ns) or not node.message:
        (trace,) = strip_rows(errors_ns, axis, width=room, height=1, dimmed=lost)
        strip = Content.assemble(" ", trace, " ")
    else:
        message = Content.styled(f" {printable(node.message):<{room + 1}}", SIGNS[node.state].style)
        strip = message.truncate(room + 2, ellipsis=True)
    row = _compact(_name(node, NAME_WIDTH), cells, strip, width)
    return row.stylize_before("$foreground-muted") if lost else row


def tall_text_width(width: int) -> int:
    """Return the cells taken by the text beside a tall strip."""
    return 34 if width < 100 else 42


def tall_strip_width(width: int) -> int:
    """Return the cells of a tall strip in a list of this width."""
    return max(width - tall_text_width(width) - AXIS_WIDTH - 1, MIN_STRIP)


def tall_rows(
    node: NodeStatus, errors_ns: list[int | None], axis: PhaseAxis, *, width: int, height: int
) -> list[Content]:
    """Return a camera in `height` lines, three or more; `errors_ns` has one value per cell of the strip."""
    lost = node.state is NodeState.LOST
    room, strip = tall_text_width(width), tall_strip_width(width)
    phase = _phase(node, axis).truncate(8, ellipsis=True, pad=True)
    label = "$foreground-muted"
    words = [
        Content.assemble(_name(node, room - 17), _state(node)),
        Content.assemble(("  phase ", label), phase, ("  error ", label), _time_error(node)),
    ]
    if node.camera.kind in WITHOUT_CAMERA:
        words.append(Content.styled(f"  {node.camera.kind}", label))
    else:
        words.append(
            Content.assemble(
                f"  {_fps(node)} fps  {_exposure(node)}  ", (count(node.drops, "drop"), _drops_style(node))
            )
        )
    if node.disk_free_bytes is not None and not node.on_leader:
        # Cameras on the leader's machine share its disk, whose free space is in the header.
        words.append(Content.styled(f"  {_disk(node)} free", label))
    if node.camera.model.strip():
        words.append(Content.styled(f"  {printable(node.camera.model)}", label))
    if any(error is not None for error in errors_ns):
        strips = strip_rows(errors_ns, axis, width=strip, height=height, dimmed=lost)
        labels = [Content.styled(text, label) for text in axis.labels(height)]
        right = [trace + beside for trace, beside in zip(strips, labels, strict=True)]
    else:
        right = _message_rows(node, strip + AXIS_WIDTH, height)
    left = [line.truncate(room, ellipsis=True, pad=True) for line in _filled(words, height)]
    rows = [line + " " + beside for line, beside in zip(left, right, strict=True)]
    return [row.stylize_before("$foreground-muted") for row in rows] if lost else rows


def _filled(lines: list[Content], height: int) -> list[Content]:
    return (lines + [Content("")] * height)[:height]


def _message_rows(node: NodeStatus, width: int, height: int) -> list[Content]:
    """Return the reason for an empty strip, in its place."""
    text = printable(node.message) or {
        NodeState.LOST: "No longer heard from. Delete removes it from the list.",
        NodeState.SYNCING: "Measuring the clock before frames can be aligned.",
        NodeState.JOINING: "Joining.",
    }.get(node.state, "")
    lines = textwrap.wrap(text, width)
    if len(lines) > height:
        lines[height - 1 :] = [" ".join(lines[height - 1 :])]
    styled = [Content.styled(line, SIGNS[node.state].style).truncate(width, ellipsis=True) for line in lines]
    return _filled([Content("")] * ((height - len(lines)) // 2) + styled, height)


def _name(node: NodeStatus, width: int) -> Content:
    branch = "  " * (node.depth - 2) + "└ " if node.depth > 1 else ""
    name = Content(f"{branch}{printable(node.camera.called(node.name))}").truncate(
        width - 1, ellipsis=True, pad=True
    )
    return Content.assemble("  ", name, " ").stylize("bold")


def _state(node: NodeStatus) -> Content:
    sign = SIGNS[node.state]
    lost = Content(f"{sign} {_ago(node.last_seen_ns)}")
    return lost if node.state is NodeState.LOST else Content.styled(str(sign), sign.style)


def _ago(ns: int) -> str:
    seconds = ns // 1_000_000_000
    if seconds < 60:
        return f"{seconds} s"
    return f"{seconds // 60} min" if seconds < 3600 else f"{seconds // 3600} h"


def _phase(node: NodeStatus, axis: PhaseAxis) -> Content:
    text = duration(node.phase_error_ns, signed=True).replace("-", "−")
    if node.phase_error_ns is None or node.state is NodeState.LOST:
        return Content(text)
    inside = abs(node.phase_error_ns) <= (node.tolerance_ns or axis.tolerance_ns)
    return Content.styled(text, "$success" if inside else "$warning")


def _time_error(node: NodeStatus) -> Content:
    return Content(NO_VALUE if node.time_error_ns is None else f"±{duration(node.time_error_ns)}")


def _fps(node: NodeStatus) -> str:
    return NO_VALUE if node.fps is None else f"{node.fps:.3g}"


def _drops_style(node: NodeStatus) -> str:
    """Return the style of dropped frames; a simulated camera is meant to drop some."""
    return "$warning" if node.drops and node.camera.kind != SIMULATED else ""


def _exposure(node: NodeStatus) -> str:
    if not (ns := node.exposure_ns):
        return NO_VALUE
    return f"{ns / 1e9:.1f} s" if ns >= 300_000_000 else f"1/{1e9 / ns:.0f} s"


def _settings(cameras: Sequence[NodeStatus]) -> str:
    """Return whether the connected cameras have equal settings, and which; empty for a single camera."""
    here = [node for node in cameras if node.state is not NodeState.LOST and node.exposure_ns]
    if len(here) < 2:
        return ""
    settings: dict[str, Sequence[float]] = {
        "exposure": [node.exposure_ns or 0 for node in here],
        "gain": [node.gain or 0 for node in here],
    }
    # Cameras round what they are set to, each in its own steps.
    if different := [what for what, values in settings.items() if max(values) > EQUAL_RATIO * min(values)]:
        return f" · different {' and '.join(different)}"
    return f" · {_exposure(here[0])}, gain {NO_VALUE if here[0].gain is None else f'{here[0].gain:.2g}'}"


def _disk(node: NodeStatus) -> str:
    return NO_VALUE if node.disk_free_bytes is None else f"{node.disk_free_bytes / 1e9:.0f} GB"


class CameraRows(RowList[NodeStatus], inherit_bindings=False):
    """Rows of the cameras, with a cursor."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "move(-1)", "Previous camera", show=False, id="rig.previous"),
        Binding("down,j", "move(1)", "Next camera", show=False, id="rig.next"),
        Binding("pageup", "move(-5)", "Five cameras up", show=False, id="rig.page-up"),
        Binding("pagedown", "move(5)", "Five cameras down", show=False, id="rig.page-down"),
        Binding("home", "move(-9999)", "First camera", show=False, id="rig.first"),
        Binding("end", "move(9999)", "Last camera", show=False, id="rig.last"),
    ]


class CameraList(Vertical):
    """List of all cameras, drawn from the record."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "open", "Details", id="rig.open", tooltip="the camera's clock, phase and picture"),
    ]

    def __init__(self, source: RigLink, record: RigRecord) -> None:
        self._source, self._record = source, record
        self._head = Lines(id="cameras-head")
        self.rows = CameraRows(1, self._draw_node, id="cameras-rows")
        self._axis = PhaseAxis.of((), None)
        super().__init__(self._head, self.rows, id="cameras")

    @staticmethod
    def rows_needed(cameras: int, room: int) -> int:
        """Return the rows that the list needs including its border, at most `room`."""
        height = _height_for(cameras, room - BORDER)
        return min(room, BORDER + (cameras * height if height > 1 else cameras + 1))

    def draw(self, room: int) -> None:
        """Draw the record in `room` rows, including the border."""
        status, width = self._record.status, self.rows.scrollable_content_region.width
        if status is None or width <= 0:
            return
        self._axis = PhaseAxis.of([node.tolerance_ns for node in status.nodes], status.period_ns)
        height = _height_for(len(status.nodes), room - BORDER)
        self._head.show([compact_head(width)] if height == 1 else [])
        self.rows.show_items({node.name: node for node in in_tree_order(status.nodes)}, height)
        title = f"{count(len(status.cameras), 'camera')}{_settings(status.cameras)}"
        write_border(self, title, f"phase error over the last {SPAN_S:.0f} s · {self._axis}")

    def _draw_node(self, node: NodeStatus, width: int, chosen: bool) -> Sequence[Content]:
        height = self.rows.row_height
        strip = tall_strip_width(width) if height > 1 else compact_strip_width(width)
        times = times_of(strip, self._record.clock())
        errors = phases_at(self._record.phases.get(node.name, ()), times)
        lines = (
            tall_rows(node, errors, self._axis, width=width, height=height)
            if height > 1
            else [compact_row(node, errors, self._axis, width)]
        )
        return [chosen_line(line, width) for line in lines] if chosen else lines

    def action_open(self) -> None:
        """Open the selected camera's screen."""
        if self.rows.chosen:
            self.app.push_screen(CameraScreen(self.rows.chosen, self._source, self._record))

    def on_row_list_chosen(self, message: RowList.Chosen) -> None:
        """Open a camera that was double-clicked."""
        if message.opens:
            self.action_open()


def _height_for(cameras: int, room: int) -> int:
    return next((height for height in HEIGHTS if cameras * height <= room), 1)
