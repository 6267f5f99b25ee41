"""One camera's preview at full size with focus and exposure aids, or two cameras blinked."""

import asyncio
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from operator import itemgetter
from typing import ClassVar

from textual import work
from textual.binding import Binding, BindingType
from textual.content import Content

from capture_app.common.text import duration
from capture_app.protocol.status import NodeStatus, Preview
from capture_app.rig.rig_link import RigLink
from capture_app.session.reading.decoding import decode_preview
from capture_app.tui.rig_record import RecordChanged, RigRecord
from capture_app.tui.signs import SIGNS
from capture_app.tui.widgets.cells import Image
from capture_app.tui.widgets.focus_aids import (
    Aid,
    Exposure,
    exposure_line,
    exposure_of,
    focus_line,
    histogram_lines,
    peaking,
    sharpness,
    zebra,
)
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.picture import NOISE, Picture
from capture_app.tui.widgets.whole_screen import WholeScreen

NUMBERS = 200
"""Number of stored focus values; covers the time over which they are compared."""
MAX_PREVIEWS = 12
"""Stored previews per camera, a few seconds' worth."""
FULL_FPS, PAIR_FPS = 10.0, 5.0
MIN_PX, MAX_PX = 640, 1280
"""Min and max width of the previews: focus needs more pixels than a terminal shows."""
BLINK_S = 0.5
HISTOGRAM_ROWS = 3


def nearest_pair(first: Iterable[Preview], second: Iterable[Preview]) -> tuple[int, Preview, Preview] | None:
    """Return two cameras' previews that are nearest in time, with their time difference in ns.

    Uses previews with known times, the newest among equals. None if a camera has no such preview.
    """
    pairs = (
        (abs(one.leader_ns - other.leader_ns), -one.leader_ns, one, other)
        for one, other in product(first, second)
        if one.leader_ns is not None and other.leader_ns is not None
    )
    found = min(pairs, key=itemgetter(0, 1), default=None)
    return None if found is None else (found[0], *found[2:])


class FullView(WholeScreen[str]):
    """Live view of a camera; Escape closes it and returns the camera shown last."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "close", "Back", id="finder.back"),
        Binding("left,up", "move(-1)", "Camera before", id="finder.before", show=False),
        Binding("right,down", "move(1)", "Next camera", id="finder.after"),
        Binding("f", "aid('focus')", "Focus peaking", id="finder.focus", tooltip="marks sharp edges"),
        Binding("z", "aid('zebra')", "Zebra", id="finder.zebra", tooltip="marks clipped pixels"),
        Binding("M", "meters", "Meters", id="finder.meters"),
        Binding("b", "blink", "Blink", id="finder.blink", tooltip="alternate this camera and the next"),
    ]

    def __init__(self, rig: RigLink, record: RigRecord, cameras: Sequence[str], camera: str) -> None:
        self._picture = Picture(words="no picture yet", noise=NOISE)
        self._meters = Lines(id="finder-meters")
        super().__init__(self._picture, self._meters)
        self._rig, self._record = rig, record
        self._cameras = tuple(cameras)
        self._at = self._cameras.index(camera)
        self._aids: dict[str, bool] = {"focus": False, "zebra": False}
        self.focus_numbers: deque[tuple[float, float]] = deque(maxlen=NUMBERS)
        """Sharpness of the preview, with its measurement time in seconds."""
        self._exposure: Exposure | None = None
        self._blinks = False
        self._previews: dict[str, deque[Preview]] = {}
        """Latest previews of the two blinked cameras."""
        self._shows_second = False
        self._newest: Preview | None = None
        """Preview to measure next or being measured; None while idle."""

    def on_mount(self) -> None:
        """Request the camera's previews."""
        self.set_interval(BLINK_S, self._blink)
        self._begin()

    @property
    def camera(self) -> str:
        """Name of the camera shown."""
        return self._cameras[self._at]

    @property
    def _partner(self) -> str:
        """Name of the camera that it is blinked with."""
        return self._cameras[(self._at + 1) % len(self._cameras)]

    @property
    def _pair(self) -> tuple[int, Preview, Preview] | None:
        return nearest_pair(*self._previews.values()) if self._blinks else None

    async def action_close(self) -> None:
        """Close; the screen below then requests its own previews."""
        await self._ask(0.0)
        self.dismiss(self.camera)

    def action_move(self, by: int) -> None:
        """Show another camera."""
        self._at = (self._at + by) % len(self._cameras)
        self._begin()

    def action_aid(self, aid: str) -> None:
        """Toggle the marking of sharp or of clipped pixels."""
        self._aids[aid] = not self._aids[aid]
        aids: dict[str, Aid] = {"focus": peaking, "zebra": zebra}
        self._picture.show_aids([aids[name] for name, on in self._aids.items() if on])
        self._show_title()

    def action_meters(self) -> None:
        """Show or hide the meters below the picture."""
        self._meters.display = not self._meters.display

    def action_blink(self) -> None:
        """Start or stop blinking with the next camera at the same instant."""
        self._blinks = not self._blinks and len(self._cameras) > 1
        self._begin()

    def on_record_changed(self, message: RecordChanged) -> None:
        """Show the camera's state and its preview."""
        if not isinstance(message.what, Preview):
            self._show_title()
        elif self._blinks:
            if message.what.camera in self._previews:
                self._previews[message.what.camera].append(message.what)
        elif message.what.camera == self.camera:
            idle, self._newest = self._newest is None, message.what
            if idle:
                self._measure()

    def _begin(self) -> None:
        self._previews = {camera: deque(maxlen=MAX_PREVIEWS) for camera in (self.camera, self._partner)}
        self._shows_second = False
        self._exposure = None
        self.focus_numbers.clear()
        self._picture.show(None)
        self._show_title()
        self._show_meters()
        self.run_worker(self._ask(PAIR_FPS if self._blinks else FULL_FPS), exclusive=True, group="previews")

    def _blink(self) -> None:
        if (pair := self._pair) is not None:
            self._shows_second = not self._shows_second
            self._picture.show((pair[2] if self._shows_second else pair[1]).jpeg)
            self._show_title()

    @work(group="measuring")
    async def _measure(self) -> None:
        """Decode and measure previews in a thread until no newer one is waiting."""
        while (preview := self._newest) is not None:
            measured = await asyncio.to_thread(_decode_and_measure, preview.jpeg)
            if measured is not None and preview.camera == self.camera:
                image, focus, self._exposure = measured
                self.focus_numbers.append((self._record.clock(), focus))
                self._picture.show(image)
                self._show_meters()
            if self._newest is preview:
                self._newest = None

    def _show_title(self) -> None:
        shown, title = self._partner if self._shows_second else self.camera, self._record.title
        cameras = () if self._record.status is None else self._record.status.cameras
        parts = [Content.styled(title(shown), "bold $primary")]
        for node in cameras:
            if node.name == shown:
                sign = SIGNS[node.state]
                parts += [Content.styled(str(sign), sign.style), *map(Content, _about(node))]
        if self._blinks:
            pair = self._pair
            apart = "waiting for both" if pair is None else f"{duration(pair[0])} apart"
            names = f"blinking {title(self.camera)} ↔ {title(self._partner)}"
            parts.insert(1, Content.styled(f"{names}, {apart}", "bold"))
        parts += [Content.styled(f"{aid} on", "$warning") for aid, on in self._aids.items() if on]
        self.title_line.show([Content(" · ").join(parts)])

    def _show_meters(self) -> None:
        if self._blinks:
            self._meters.show([])
            return
        lines = [focus_line(self.focus_numbers)]
        if self._exposure is not None:
            width = max(min(self.size.width - 2, len(self._exposure.histogram)), 1)
            lines += [exposure_line(self._exposure), *histogram_lines(self._exposure, width, HISTOGRAM_ROWS)]
        self._meters.show(lines)

    async def _ask(self, fps: float) -> None:
        cameras = (self.camera, self._partner) if self._blinks else (self.camera,)
        await self._rig.want_previews(
            cameras=cameras, width=min(max(2 * self.app.size.width, MIN_PX), MAX_PX), fps=fps
        )


def _about(node: NodeStatus) -> Iterator[str]:
    if node.fps is not None:
        yield f"{node.fps:.1f} fps"
    if node.exposure_ns is not None:
        yield f"exposure {duration(node.exposure_ns)}"
    if node.gain is not None:
        yield f"gain {node.gain:.1f}"


def _decode_and_measure(jpeg: bytes) -> tuple[Image, float, Exposure] | None:
    image = decode_preview(jpeg)
    return None if image is None else (image, sharpness(image), exposure_of(image))
