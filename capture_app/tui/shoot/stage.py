"""Main area of the mode Shoot: live previews, countdown, or contact sheet of the last take."""

from collections import deque
from functools import partial
from statistics import mean

from textual.containers import Vertical
from textual.content import Content
from textual.widgets import ContentSwitcher, Digits

from capture_app.common.text import duration, printable
from capture_app.protocol.status import Preview
from capture_app.rig.instant_previews import Gathering, old_from_s
from capture_app.rig.rig_link import RigLink
from capture_app.session.format.live_pictures import DepthPreview, LivePicture, PeoplePreview
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.rig_record import RigRecord
from capture_app.tui.shoot.preview_grid import PreviewGrid, age_words
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.lines import Lines, write_border

LIVE, SHEET, COUNTDOWN = "live", "sheet", "countdown"
LATEST = 20
"""Number of latest pictures over which their figures are averaged."""


class Stage(ContentSwitcher):
    """Switcher between live previews, contact sheet and countdown; `current` is the one shown."""

    def __init__(self, rig: RigLink, record: RigRecord) -> None:
        self._rig, self._record = rig, record
        self._asked: tuple[int, float] = (0, 0.0)
        self._gathering = Gathering()
        self._live = ""
        """What the newest instant's pictures are, in words."""
        self._found_s: deque[float] = deque(maxlen=LATEST)
        """Times (s) at which the latest were shown."""
        self._moving: deque[float] = deque(maxlen=LATEST)
        """Fractions of moving pixels that have depth."""
        self._shows_found = False
        self.grid = PreviewGrid(rig, record, id=LIVE)
        self.sheet = ContactSheet(id=SHEET)
        self._digits = Digits("")
        self._words = Lines()
        super().__init__(
            self.grid,
            self.sheet,
            Vertical(self._digits, self._words, id=COUNTDOWN),
            id="shoot-stage",
            initial=LIVE,
        )
        self.border_title = "Live"

    @property
    def is_sheet(self) -> bool:
        """Whether it shows the last take."""
        return self.current == SHEET

    def show_preview(self, preview: Preview) -> None:
        """Show a camera's preview, and how far apart in time the previews of its instant are."""
        shown, found = self._gathering.add(preview)
        self.grid.show_previews(shown)
        if found is not None and len(found.previews) > 1:
            status = self._record.status
            order = f", {printable(status.order)}," if status is not None and status.order else ""
            # Short enough for a window of 80 columns.
            self._live = f"{len(found.previews)} pictures{order} within {duration(found.spread_ns)}"

    def on_preview_grid_drawn(self) -> None:
        """Say of which moment the new previews are."""
        self.show_ages()

    def show_ages(self) -> None:
        """Say of which moment the previews are: live, or how long ago."""
        age_s = self.grid.show_ages()
        if self.current != LIVE or self._shows_found:
            return
        if age_s is None:
            write_border(self, "Live")
        elif age_s > old_from_s(self._record.status):
            write_border(self, f"Not live · pictures of {age_words(age_s)}")
        else:
            write_border(self, f"Live · {self._live}" if self._live else "Live")

    def show_found(self, found: LivePicture | None) -> None:
        """Show what was found in a camera's preview, with its rate and delay; None: nothing."""
        self.grid.show_found(found)
        self._shows_found = found is not None
        if found is None:
            self._found_s.clear()
            self._moving.clear()
            write_border(self, "Live" if self.current == LIVE else None)
            return
        # A narrow window has room for the reason alone.
        camera = self._record.title(found.camera)
        what = f"depth of {camera}"
        if isinstance(found, PeoplePreview):
            what = found.counted
        words = [f"Live · {printable(found.problem) or what}"]
        if not found.problem:
            self._found_s.append(self._record.clock())
            words += found.rate_and_delay(self._found_s)
        if isinstance(found, DepthPreview) and found.moving_confirmed is not None:
            self._moving.append(found.moving_confirmed)
        if self._moving:
            words.append(f"{100 * mean(self._moving):.0f} % of moving pixels have depth")
        if isinstance(found, PeoplePreview):
            words += [f"without {self._record.title(name)}" for name in sorted(found.absent)]
        write_border(self, " · ".join(words))

    def show_live(self) -> None:
        """Show the live previews."""
        self._go_to(LIVE, "Live")

    def load_sheet(self, sheet: TakeSheet, instant: int) -> None:
        """Load a take into the sheet, with the cursor at an instant."""
        self.sheet.show(sheet)
        self.sheet.go_to(sheet.cameras[0], min(instant, sheet.instants - 1))
        if self.is_sheet:
            self.show_sheet()

    def show_sheet(self) -> None:
        """Show the sheet of the loaded take."""
        if self.sheet.sheet is not None:
            self._go_to(SHEET, self.sheet.sheet.session.name)

    def forget_sheet(self, sheet: TakeSheet) -> None:
        """Unload a take that was removed."""
        if self.sheet.sheet is sheet:
            self.sheet.show(None)
            self.show_live()

    def count_down(self, seconds: int, words: str) -> None:
        """Show the remaining seconds in digits readable from a distance."""
        self._digits.update(str(seconds))
        self._words.show([Content.styled(f"{words} · Space stops it", "$foreground-muted")])
        self._go_to(COUNTDOWN, "Countdown")

    def end_countdown(self) -> None:
        """Show the live previews again."""
        # The screen may be closed during the countdown.
        if self.current == COUNTDOWN and self.grid.is_attached:
            self.show_live()

    def want_previews(self, seen: bool) -> None:
        """Request the previews that are visible, if the request has changed."""
        request = (
            self.grid.request if seen and self.current == LIVE and self.grid.tiles else (self._asked[0], 0.0)
        )
        if request != self._asked and (request[1] or self._asked[1]):
            self._asked = width, fps = request
            # A coroutine of a worker that is cancelled before it begins would never be awaited.
            asking = partial(self._rig.want_previews, cameras=None, width=width, fps=fps)
            self.run_worker(asking, exclusive=True, group="previews")  # type: ignore[arg-type]

    def _go_to(self, stage: str, title: str) -> None:
        write_border(self, printable(title))
        self.current = stage
