"""Grid of all cameras' previews, each as large as the space allows."""

import asyncio
import math
from collections.abc import Iterable
from typing import ClassVar

from textual import events, work
from textual.binding import Binding, BindingType
from textual.containers import Container, Vertical
from textual.content import Content
from textual.message import Message

from capture_app.common import system
from capture_app.common.node_state import NodeState
from capture_app.common.text import printable
from capture_app.protocol.status import NodeStatus, Preview, RigStatus
from capture_app.rig.instant_previews import APART_S, old_from_s
from capture_app.rig.rig_link import RigLink
from capture_app.session.format.live_pictures import LivePicture
from capture_app.tui.rig_record import RigRecord
from capture_app.tui.shoot.full_view import FullView
from capture_app.tui.signs import SIGNS, UNKNOWN
from capture_app.tui.widgets.lines import Lines, fitting
from capture_app.tui.widgets.picture import NOISE, Picture, draw_for

ASPECT = 0.75
"""Height over width of the previews that the layout assumes."""
GRID_FPS, MANY_FPS = 2.5, 1.25
MANY = 8
"""Number of cameras above which the preview rate is lower."""
MIN_PX, MAX_PX = 64, 640
REST = 3.0
"""Rest after pictures were drawn, in times of their drawing: keys are answered first on a busy machine."""


def grid_columns(cameras: int, width: int, height: int) -> int:
    """Return the number of columns that makes this many pictures largest; a cell is twice as high as wide."""

    def picture_width(columns: int) -> float:
        return min(width / columns, (height / math.ceil(cameras / columns) - 1) * 2 / ASPECT)

    return max(range(1, max(cameras, 1) + 1), key=lambda columns: (picture_width(columns), -columns))


def age_words(seconds: float) -> str:
    """Return how long ago something was, as `4 s ago` or `3 min ago`."""
    if seconds >= 120:
        return f"{seconds / 60:.0f} min ago"
    return f"{seconds:.{0 if seconds >= 1 else 1}f} s ago"


class PreviewTile(Vertical):
    """One camera: name, state and frame rate above its preview."""

    def __init__(self, node: NodeStatus) -> None:
        self._title = Lines()
        self.picture = Picture(words="no picture yet", noise=NOISE)
        self._node, self._sign = node, SIGNS[node.state]
        self.moment_s: float | None = None
        """When what it shows was, by the record's clock; None without a preview."""
        self._age = ""
        super().__init__(self._title, self.picture)

    @property
    def title(self) -> str:
        """Text above the preview."""
        return "".join(self._title.plain)

    def show_node(self, node: NodeStatus) -> None:
        """Show the camera's state."""
        self._node, self._sign = node, SIGNS[node.state]
        self.picture.is_grey = node.state is NodeState.LOST
        self._show()

    def show_lost(self) -> None:
        """Show that nobody knows the camera's state."""
        self._sign = UNKNOWN
        self.picture.is_grey = True
        self._show()

    def show_age(self, now_s: float, newest_s: float, old_s: float) -> None:
        """Say how old the picture is if it is older than the newest ones, or if these are old."""
        moment_s = self.moment_s
        is_old = moment_s is not None and (now_s - moment_s > old_s or newest_s - moment_s > APART_S)
        age = f" {age_words(now_s - moment_s)}" if is_old and moment_s is not None else ""
        if age != self._age:
            self._age = age
            self.picture.is_faded = is_old
            self._show()

    def mark(self, *, chosen: bool) -> None:
        """Show whether the cursor is here."""
        if chosen != self.has_class("chosen"):
            self.set_class(chosen, "chosen")
            self._show()

    def _show(self) -> None:
        node, sign = self._node, self._sign
        title = Content.assemble(
            ("▸" if self.has_class("chosen") else " ", "bold $primary"),
            (f"{sign.glyph} ", sign.style),
            (printable(node.camera.called(node.name)), "bold"),
        )
        rate = "" if node.fps is None or self.picture.is_grey else f" {node.fps:.1f} fps"
        # How long a camera is lost says more than how old its picture is.
        is_lost = sign is SIGNS[NodeState.LOST]
        word = f" {sign.word}{f' {age_words(1e-9 * node.last_seen_ns)}' * is_lost}"
        parts = (
            title,
            Content.styled("" if is_lost else self._age, "$warning"),
            Content.styled(word, sign.style),
            Content.styled(rate, "$foreground-muted"),
        )
        # Parts that do not fit are omitted rather than cut.
        self._title.show([Content("").join(fitting(parts, "", self.size.width))])

    on_resize = _show


class PreviewGrid(Container, can_focus=True):
    """Grid of all cameras; the cursor selects one, Enter opens it at full size."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "move(-1,0)", "Camera before", id="previews.left", show=False),
        Binding("right", "move(1,0)", "Camera after", id="previews.right", show=False),
        Binding("up", "move(0,-1)", "Camera above", id="previews.up", show=False),
        Binding("down", "move(0,1)", "Camera below", id="previews.down", show=False),
        Binding("enter", "choose", "Full size", id="previews.open"),
    ]

    class Drawn(Message):
        """New previews are shown."""

    def __init__(self, rig: RigLink, record: RigRecord, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._rig, self._record = rig, record
        self._tiles: dict[str, PreviewTile] = {}
        self._columns = 1
        self._at = 0
        self._waiting: dict[str, Preview] = {}
        """Previews to draw next, by camera."""
        self._is_drawing = False
        self._found_in = ""
        """Camera whose depth or people are shown instead of its preview; empty for none."""

    @property
    def tiles(self) -> tuple[PreviewTile, ...]:
        """Tiles of the cameras, in their order."""
        return tuple(self._tiles.values())

    @property
    def request(self) -> tuple[int, float]:
        """Width (px) and rate (frames per second) of the previews to request from the leader."""
        pixels = 2 * self.size.width // max(self._columns, 1)
        fps = MANY_FPS if len(self._tiles) > MANY else GRID_FPS
        # Rounded up to 64 pixels, so that resizing a window does not send a new request for each column.
        return min(max(pixels + -pixels % 64, MIN_PX), MAX_PX), fps

    def go_to(self, camera: str) -> None:
        """Move the cursor to a camera."""
        if camera in self._tiles:
            self._choose(list(self._tiles).index(camera))

    def show_status(self, status: RigStatus) -> None:
        """Show the cameras of a status."""
        nodes = {node.name: node for node in status.cameras}
        if list(nodes) != list(self._tiles):
            before = self._tiles
            self._tiles = {name: before.get(name) or PreviewTile(node) for name, node in nodes.items()}
            with self.app.batch_update():
                self.remove_children([tile for name, tile in before.items() if name not in nodes])
                self.mount(*(tile for tile in self.tiles if not tile.is_attached))
                order = {tile: at for at, tile in enumerate(self.tiles)}
                self.sort_children(key=lambda child: order.get(child, len(order)))  # type: ignore[call-overload]
            self._at = min(self._at, max(len(self._tiles) - 1, 0))
            self._lay_out()
        for name, node in nodes.items():
            self._tiles[name].show_node(node)

    def show_lost(self) -> None:
        """Show that the leader is lost, which knows the cameras' states."""
        for tile in self.tiles:
            tile.show_lost()

    def chosen(self) -> str:
        """Return the camera under the cursor; empty without cameras."""
        return next(iter([*self._tiles][self._at :]), "")

    def show_previews(self, previews: Iterable[Preview]) -> None:
        """Show previews together, once earlier ones are drawn; none of a camera whose depth or people are."""
        self._waiting.update((each.camera, each) for each in previews)
        if self._waiting and not self._is_drawing:
            self._is_drawing = True
            self._draw()

    def show_ages(self) -> float | None:
        """Say which pictures are old; return the age of the newest in seconds, None without one."""
        moments = [tile.moment_s for tile in self.tiles if tile.moment_s is not None]
        now_s, newest_s = self._record.clock(), max(moments, default=-math.inf)
        for tile in self.tiles:
            tile.show_age(now_s, newest_s, old_from_s(self._record.status))
        return now_s - newest_s if moments else None

    @work(group="drawing")
    async def _draw(self) -> None:
        """Draw what waits, and rest in between; what is overtaken is not drawn."""
        try:
            while self._waiting:
                begun_s = system.monotonic_s()
                previews, self._waiting = self._waiting, {}
                drawn = [
                    (tile, preview, size := tile.picture.size, await draw_for(self.app, preview.jpeg, size))
                    for camera, preview in previews.items()
                    if camera != self._found_in
                    and (tile := self._tiles.get(camera)) is not None
                    and tile.picture.size
                ]
                with self.app.batch_update():
                    for tile, preview, size, cells in drawn:
                        tile.picture.show_drawn(preview.jpeg, cells, size)
                        tile.moment_s = self._record.moment_s(preview.leader_ns)
                self.post_message(self.Drawn())
                await asyncio.sleep(REST * (system.monotonic_s() - begun_s))
        finally:
            self._is_drawing = False

    def show_found(self, found: LivePicture | None) -> None:
        """Show what was found instead of its camera's preview; None: all previews again."""
        self._found_in = "" if found is None or not found.jpeg else found.camera
        if found is not None and (tile := self._tiles.get(self._found_in)) is not None:
            tile.picture.show(found.jpeg)
            tile.moment_s = None  # the title says how late it is

    def action_move(self, x: int, y: int) -> None:
        """Move the cursor."""
        self._choose(self._at + x + y * self._columns)

    def action_choose(self) -> None:
        """Open the camera under the cursor."""
        if self.tiles:
            cameras = tuple(self._tiles)
            full = FullView(self._rig, self._record, cameras, cameras[self._at])
            self.app.push_screen(full, lambda camera: None if camera is None else self.go_to(camera))

    def watch_has_focus(self, has_focus: bool) -> None:
        """Show or hide the cursor."""
        super().watch_has_focus(has_focus)
        self._choose(self._at)

    def on_click(self, event: events.Click) -> None:
        """Open the camera that was clicked."""
        for at, tile in enumerate(self.tiles):
            if tile.region.contains(*event.screen_offset):
                self._choose(at)
                self.action_choose()

    def _lay_out(self) -> None:
        if self.size and self._tiles:
            self._columns = grid_columns(len(self._tiles), self.size.width, self.size.height)
            self.styles.grid_size_columns = self._columns
            self.styles.grid_size_rows = math.ceil(len(self._tiles) / self._columns)

    on_resize = _lay_out

    def _choose(self, at: int) -> None:
        if not 0 <= at < len(self._tiles):
            return
        self._at = at
        for place, tile in enumerate(self.tiles):
            tile.mark(chosen=place == at and self.has_focus)
