"""The tables of the screen: cameras with their state, clock and phase; saved sessions with comparisons."""

import math
from pathlib import Path
from statistics import median

from rich.text import Text
from textual.widgets import DataTable

from capture_app.node.wire.status import NodeStatus
from capture_app.session.format.manifest import Manifest
from capture_app.sync.wire.messages import NodeState
from capture_app.text import NO_VALUE, clock_offset, duration, printable

STATE_STYLES = {
    NodeState.JOINING: "dim",
    NodeState.SYNCING: "yellow",
    NodeState.ALIGNING: "yellow",
    NodeState.COARSE: "yellow",
    NodeState.READY: "green",
    NodeState.LOST: "red",
    NodeState.FAILED: "red",
}
NARROW = ("camera", "state", "offset", "±bound", "trip", "phase", "drops")
WIDE = ("camera", "state", "model", "offset", "±bound", "round trip", "phase", "", "drops")
GAUGE_WIDTH = 15
GAUGE_FULL_SCALE_NS = 16_666_667
"""Half a period at 30 fps: the farthest that a stream can be from the grid."""
_GAUGE_LINEAR_NS = 10_000
NUMBERS = {"offset", "±bound", "trip", "round trip", "phase", "drops"}


class NodesTable(DataTable[Text]):
    """One row a camera; the columns depend on the room there is."""

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id, cursor_type="none", zebra_stripes=True, cell_padding=1)
        self._shown: tuple[NodeStatus, ...] = ()
        self._wide: bool | None = None

    def show(self, nodes: tuple[NodeStatus, ...], *, wide: bool) -> None:
        """Show these cameras, changing only the cells that differ."""
        labels = WIDE if wide else NARROW
        if wide is not self._wide or [n.name for n in nodes] != [n.name for n in self._shown]:
            self.clear(columns=True)
            for label in labels:
                self.add_column(Text(label, justify="right" if label in NUMBERS else "left"), key=label)
            for node in nodes:
                self.add_row(*_cells(node, wide=wide), key=node.name)
        else:
            for node in nodes:
                for label, cell in zip(labels, _cells(node, wide=wide), strict=True):
                    if self.get_cell(node.name, label) != cell:
                        self.update_cell(node.name, label, cell, update_width=True)
        self._shown, self._wide = nodes, wide


def _cells(node: NodeStatus, *, wide: bool) -> list[Text]:
    style = STATE_STYLES[node.state]
    gone = node.state in (NodeState.LOST, NodeState.FAILED)
    plain = "dim" if gone else ""
    phase_style = plain or ("green" if node.state is NodeState.READY else "yellow")
    name = Text("  " * (node.depth - 1) + node.name, style="bold " + plain)
    state = Text(f"● {node.state.value}", style=style)
    offset = Text(clock_offset(node.offset_ns), style=plain, justify="right")
    bound = Text(duration(node.hard_bound_ns), style=plain, justify="right")
    trip = Text(duration(node.round_trip_ns), style=plain, justify="right")
    phase = Text(duration(node.phase_error_ns, signed=True), style=phase_style, justify="right")
    drops = Text(str(node.drops), style=plain or ("yellow" if node.drops else ""), justify="right")
    if not wide:
        return [name, state, offset, bound, trip, phase, drops]
    model = Text(printable(node.camera.model), style="dim")
    mark = Text(gauge(None if gone else node.phase_error_ns, GAUGE_WIDTH), style=phase_style)
    return [name, state, model, offset, bound, trip, phase, mark, drops]


def gauge(error_ns: int | None, width: int) -> str:
    """Return a stream's distance from the grid as a mark on a line, the middle being in step.

    The scale is logarithmic on both sides from 10 µs up to half a period, so that a camera can be seen
    coming home from milliseconds to microseconds.
    """
    middle = width // 2
    line = ["·"] * width
    line[middle] = "│"
    if error_ns is not None:
        full = math.log1p(GAUGE_FULL_SCALE_NS / _GAUGE_LINEAR_NS)
        share = math.log1p(abs(error_ns) / _GAUGE_LINEAR_NS) / full
        steps = round(min(share, 1.0) * ((width - 1) // 2))
        line[middle + int(math.copysign(steps, error_ns))] = "●"
    return "".join(line)


def describe_manifest(manifest: Manifest) -> tuple[str, str]:
    """Return a session's images (have/asked), and how far one instant's are apart with the clocks' bound."""
    asked = len(manifest.images) + len(manifest.missing)
    apart = manifest.sync.spread_ns if manifest.sync is not None else ()
    sync = duration(round(median(apart))) if apart else NO_VALUE
    if manifest.sync is not None and manifest.sync.hard_bound_ns is not None:
        sync += f" ±{duration(manifest.sync.hard_bound_ns)}"
    return f"{len(manifest.images)}/{asked}", sync


class SessionsTable(DataTable[Text]):
    """One row a session, newest on top; the cursor chooses the one to compare."""

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id, cursor_type="row", cell_padding=1)
        self._paths: list[Path] = []

    def on_mount(self) -> None:
        """Make the columns."""
        for label in ("session", "images", "apart", "comparison"):
            self.add_column(label, key=label)

    @property
    def selected(self) -> Path | None:
        """The session under the cursor."""
        if not self._paths:
            return None
        return Path(str(self.coordinate_to_cell_key(self.cursor_coordinate).row_key.value))

    def add_session(self, path: Path, images: str, sync: str) -> None:
        """Put a new session on top and choose it."""
        self._paths.append(path)
        cells = [Text(path.name, style="bold"), Text(images), Text(sync), Text("press c", style="dim")]
        self.add_row(*cells, key=str(path))
        self.sort("session", key=lambda cell: str(cell), reverse=True)
        self.move_cursor(row=self.get_row_index(str(path)))

    def show_comparison(self, path: Path, text: str, style: str = "") -> None:
        """Write what the comparison of a session says, or how far it is."""
        self.update_cell(str(path), "comparison", Text(text, style=style), update_width=True)
