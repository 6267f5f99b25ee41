"""Picture of a take on the whole screen: still, blinked with a neighbour, or in motion."""

from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from typing import ClassVar, Literal, TypeVar

from textual.binding import Binding, BindingType
from textual.content import Content
from textual.timer import Timer

from capture_app.common.text import duration, printable
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.widgets.cells import Image
from capture_app.tui.widgets.picture import Picture, Source, sharp_terminal_of
from capture_app.tui.widgets.whole_screen import WholeScreen

T = TypeVar("T")
SLOWEST, FASTEST = 1.0, 8.0
"""Min and max pictures per second; more would overload a slow link."""
MAX_CACHED = 80
"""Max number of cached pictures, decoded at the size of the screen."""


Motion = Literal["still", "cameras", "instants", "wiggle", "play"]
"""Kind of automatic change."""
_MOVING: dict[Motion, tuple[str, float]] = {
    "cameras": ("blinking two cameras", 2.0),
    "instants": ("blinking two instants", 2.0),
    "wiggle": ("wiggle through the cameras", 6.0),
    "play": ("all instants", 6.0),
}
"""Description and initial pictures per second of each motion."""


def ping_pong(things: Sequence[T]) -> list[T]:
    """Return the sequence forwards and then backwards, without repeating either end."""
    return [*things, *things[-2:0:-1]]


class LookScreen(WholeScreen[tuple[str, int]]):
    """Screen of one picture; Escape closes it and returns the last camera and instant."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "close", "Back", id="look.back"),
        Binding("left", "move(-1,0)", "Camera before", id="look.left", show=False),
        Binding("right", "move(1,0)", "Camera after", id="look.right", show=False),
        Binding("up", "move(0,-1)", "Instant before", id="look.up", show=False),
        Binding("down", "move(0,1)", "Instant after", id="look.down", show=False),
        Binding(
            "b",
            "motion('cameras')",
            "Blink",
            id="look.blink-cameras",
            tooltip="alternate two cameras",
        ),
        Binding(
            "B",
            "motion('instants')",
            "Blink instants",
            id="look.blink-instants",
            tooltip="alternate two instants",
        ),
        Binding(
            "w", "motion('wiggle')", "Wiggle", id="look.wiggle", tooltip="back and forth through the cameras"
        ),
        Binding("P", "motion('play')", "Play", id="look.play"),
        Binding("plus,equals_sign", "speed(1.5)", "Faster", id="look.faster", show=False, key_display="+"),
        Binding("minus", "speed(0.67)", "Slower", id="look.slower", show=False, key_display="-"),
    ]

    def __init__(self, sheet: TakeSheet, camera: str, instant: int, motion: Motion = "still") -> None:
        self._picture = Picture(words="no picture")
        super().__init__(self._picture)
        self._sheet = sheet
        self._camera, self._instant = sheet.cameras.index(camera), instant
        self.motion = motion
        self._rate = _MOVING[motion][1] if motion in _MOVING else 0.0
        self._step = 0
        self._timer: Timer | None = None
        self._sources: dict[tuple[str, int], tuple[Source, Source]] = {}
        self._load = lru_cache(maxsize=MAX_CACHED)(
            lambda camera, instant: sheet.load(camera, instant, 2 * self.app.size.width)
        )

    @property
    def shown(self) -> tuple[str, int]:
        """Camera and instant on display."""
        camera, instant = self._frame
        return self._sheet.cameras[camera], instant

    @property
    def _frame(self) -> tuple[int, int]:
        frames = self._frames()
        return frames[self._step % len(frames)]

    def action_close(self) -> None:
        """Close the screen."""
        self.dismiss((self._sheet.cameras[self._camera], self._instant))

    def action_move(self, cameras: int, instants: int) -> None:
        """Show another camera or instant."""
        self._camera = min(max(self._camera + cameras, 0), len(self._sheet.cameras) - 1)
        self._instant = min(max(self._instant + instants, 0), self._sheet.instants - 1)
        self._step = 0
        self._show()

    def action_motion(self, motion: Motion) -> None:
        """Start blinking, wiggling or playing; the same key stops at the current picture."""
        if motion == self.motion:
            self._camera, self._instant = self._frame
            motion = "still"
        self.motion, self._step = motion, 0
        self._rate = _MOVING[motion][1] if motion in _MOVING else 0.0
        self._start()

    def action_speed(self, factor: float) -> None:
        """Change the speed of the motion."""
        if self.motion != "still":
            self._rate = min(max(self._rate * factor, SLOWEST), FASTEST)
            self._start()

    def _start(self) -> None:
        if self._timer is not None:
            self._timer.stop()
        moves = self.motion != "still" and len(self._frames()) > 1
        self._timer = self.set_interval(1 / self._rate, self._advance) if moves else None
        self._show()

    on_mount = _start

    def _advance(self) -> None:
        self._step += 1
        self._show()

    def _frames(self) -> list[tuple[int, int]]:
        """Return the pictures shown in turn, as indices of camera and instant."""
        cameras, instants = len(self._sheet.cameras), self._sheet.instants
        at, when = self._camera, self._instant
        match self.motion:
            case "still":
                return [(at, when)]
            case "cameras":
                return [(at, when), (at + 1 if at + 1 < cameras else max(at - 1, 0), when)]
            case "instants":
                return [(at, when), (at, when + 1 if when + 1 < instants else max(when - 1, 0))]
            case "wiggle":
                return [(self._sheet.cameras.index(camera), when) for camera in ping_pong(self._sheet.arc)]
            case "play":
                return [(at, instant) for instant in range(instants)]

    def _show(self) -> None:
        here = self.shown
        found = self._sources.setdefault(here, (partial(self._load, *here), partial(self._load_sharp, *here)))
        words = printable(self._sheet.note(*here)) if self._sheet.image(*here) is None else "no picture"
        self._picture.show(found[0], words, sharp=found[1] if self.motion == "still" else None)
        self.title_line.show([Content(" · ").join(self._describe(*here))])

    def _describe(self, camera: str, instant: int) -> Iterator[Content]:
        image, note = self._sheet.image(camera, instant), self._sheet.note(camera, instant)
        yield Content.styled(printable(camera), "bold $primary")
        yield Content(f"instant {instant + 1} of {self._sheet.instants}")
        yield Content(duration(self._sheet.since_start_ns(instant), signed=True))
        if image is not None:
            bar = "" if image.uncertainty_ns is None else f" ±{duration(image.uncertainty_ns)}"
            yield Content(f"{duration(image.residual_ns, signed=True)}{bar} from it")
        if note:
            yield Content.styled(f"! {printable(note)}", "$warning")
        if self.motion == "cameras" and (apart := self._apart_ns()) is not None:
            yield Content.styled(f"{duration(apart)} apart", "bold")
        if self.motion != "still":
            yield Content.styled(f"{_MOVING[self.motion][0]}, {self._rate:.1f}/s", "$foreground-muted")

    def _apart_ns(self) -> int | None:
        """Return the time between the two blinked pictures, in ns."""
        images = [self._sheet.image(self._sheet.cameras[at], when) for at, when in self._frames()]
        times = [image.leader_ns for image in images if image is not None]
        return max(times) - min(times) if len(times) == 2 else None

    def _load_sharp(self, camera: str, instant: int) -> Image | None:
        """Load a picture at the terminal's resolution; not cached, because it is large."""
        terminal = sharp_terminal_of(self.app)
        width = 0 if terminal is None else terminal.width_px(self.app.size.width)
        return self._sheet.load(camera, instant, width) if width else None
