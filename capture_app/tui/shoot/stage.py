"""The large part of the mode Shoot: what the cameras see, the countdown, or the sheet of the last take.

The course of a take: countdown, then once, every so often or one after the other, until it is stopped.
"""

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from itertools import count

from textual import work
from textual.containers import Vertical
from textual.content import Content
from textual.message import Message
from textual.widgets import ContentSwitcher, Digits

from capture_app.errors import SimulshotError
from capture_app.node.rig_link import RigLink
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.text import printable
from capture_app.tui.rig_record import Mishap
from capture_app.tui.shoot.full_view import CameraScreen
from capture_app.tui.shoot.plan import TakeMode, TakePlan
from capture_app.tui.shoot.preview_grid import PreviewGrid
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.look import LookScreen, Motion


@dataclass(frozen=True, slots=True)
class Moment:
    """What is under way: a countdown or a pause of so many seconds, or a take; and which take it is."""

    number: int
    total: int
    seconds: int = 0
    """Left until the take; 0 while it is taken."""

    def __str__(self) -> str:
        """Return it in words."""
        of = f"take {self.number} of {self.total}" if self.total > 1 else "the take"
        return f"{of} in {self.seconds} s" if self.seconds else f"{of} is being taken"


class Shooting:
    """Takes as planned. `take` orders a burst; its event is set when that is saved or has failed."""

    def __init__(
        self,
        take: Callable[[], asyncio.Event],
        show: Callable[[Moment], None],
        *,
        now: Callable[[], float],
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        """`now` and `sleep`: seconds."""
        self._take, self._show = take, show
        self._now, self._sleep = now, sleep

    async def run(self, plan: TakePlan) -> None:
        """Take as planned, and return when the last take is ordered.

        An interval does not wait for the take before to be saved.
        """
        total = plan.takes if plan.mode in (TakeMode.INTERVAL, TakeMode.SEQUENCE) else 1
        due = self._now() + plan.countdown_s
        for number in count(1):
            await self._wait(due, number, total)
            self._show(Moment(number, total))
            done = self._take()
            if number == total:
                return
            if plan.mode is TakeMode.INTERVAL:
                due += plan.every_s
            else:
                await done.wait()
                due = self._now() + plan.countdown_s

    async def _wait(self, due: float, number: int, total: int) -> None:
        while (left := due - self._now()) > 0:
            seconds = math.ceil(left)
            self._show(Moment(number, total, seconds))
            # Until the next whole second, so that the number on the screen changes when it is told.
            await self._sleep(max(left - (seconds - 1), 0.001))


LIVE, SHEET, COUNTDOWN = "live", "sheet", "countdown"


class Stage(ContentSwitcher):
    """Shows one of the three, and says when it shows another."""

    DEFAULT_CSS = """
    Stage { width: 1fr; height: 1fr; border: round $border; }
    Stage:focus-within { border: round $primary; }
    Stage > #countdown { align: center middle; }
    Stage > #countdown Digits { width: auto; color: $primary; }
    Stage > #countdown Lines { width: auto; margin-top: 1; }
    """

    class Changed(Message):
        """It shows something else."""

    def __init__(self, rig: RigLink, clock: Callable[[], float]) -> None:
        """`clock`: seconds."""
        self._rig, self._clock = rig, clock
        self._asked: tuple[int, float] = (0, 0.0)
        self.grid = PreviewGrid(id=LIVE)
        self.sheet = ContactSheet(id=SHEET)
        self._digits = Digits("")
        self._words = Lines()
        countdown = Vertical(self._digits, self._words, id=COUNTDOWN)
        super().__init__(self.grid, self.sheet, countdown, id="shoot-stage", initial=LIVE)
        self.border_title = "Live"

    @property
    def is_live(self) -> bool:
        """Whether it shows what the cameras see."""
        return self.current == LIVE

    @property
    def is_sheet(self) -> bool:
        """Whether it shows the last take."""
        return self.current == SHEET

    def show_live(self) -> None:
        """Show what the cameras see."""
        self._go_to(LIVE, "Live")

    def load_sheet(self, sheet: TakeSheet, instant: int) -> None:
        """Have a take at hand, with the cursor at an instant."""
        self.sheet.show(sheet)
        self.sheet.go_to(sheet.cameras[0], min(instant, sheet.instants - 1))
        if self.is_sheet:
            self.show_sheet()

    def show_sheet(self) -> None:
        """Show the take that is at hand."""
        if self.sheet.sheet is not None:
            self._go_to(SHEET, self.sheet.sheet.session.name)

    def forget_sheet(self, sheet: TakeSheet) -> None:
        """Show a take no more: it is gone."""
        if self.sheet.sheet is sheet:
            self.sheet.show(None)
            self.show_live()

    def show_moment(self, moment: Moment) -> None:
        """Count down in digits that are read from afar, then show what the cameras see."""
        if moment.seconds:
            self._digits.update(str(moment.seconds))
            self._words.show([Content.styled(f"{moment} · Space stops it", "$foreground-muted")])
            self._go_to(COUNTDOWN, "Countdown")
        else:
            self.end_countdown()

    def end_countdown(self) -> None:
        """Count down no more."""
        if self.current == COUNTDOWN:
            self.show_live()

    def switch(self) -> None:
        """Switch between what the cameras see and the last take."""
        if self.is_live:
            self.show_sheet()
        else:
            self.show_live()

    def wiggle(self) -> None:
        """Wiggle through the cameras at the chosen instant of the last take."""
        if (place := self.sheet.place) is not None:
            self._look(place.camera, place.instant, Motion.WIGGLE)

    def on_preview_grid_chosen(self, message: PreviewGrid.Chosen) -> None:
        """Look through one camera."""
        message.stop()
        finder = CameraScreen(self._rig, self.grid.cameras, message.camera, clock=self._clock)
        self.app.push_screen(finder, lambda camera: None if camera is None else self.grid.go_to(camera))

    def on_contact_sheet_chosen(self, message: ContactSheet.Chosen) -> None:
        """Look at one picture."""
        message.stop()
        self._look(message.camera, message.instant, Motion.STILL)

    def focus_first(self) -> bool:
        """Give the sheet the focus where it is shown."""
        if self.current == SHEET:
            self.sheet.focus()
        return self.current == SHEET

    def want_previews(self, seen: bool) -> None:
        """Ask for the previews that are looked at, where that has changed."""
        looking = seen and self.is_live and bool(self.grid.tiles)
        wanted = self.grid.wanted if looking else (self._asked[0], 0.0)
        if wanted != self._asked and (wanted[1] or self._asked[1]):
            self._asked = wanted
            self._ask_previews(*wanted)

    @work(exclusive=True, group="previews")
    async def _ask_previews(self, width: int, fps: float) -> None:
        try:
            await self._rig.want_previews(cameras=None, width=width, fps=fps)
        except SimulshotError as error:
            self.post_message(Mishap(error))

    def _look(self, camera: str, instant: int, motion: Motion) -> None:
        if self.sheet.sheet is not None:
            look = LookScreen(self.sheet.sheet, camera, instant, motion)
            self.app.push_screen(look, lambda at: None if at is None else self.sheet.go_to(*at))

    def _go_to(self, stage: str, title: str) -> None:
        self.border_title = Content(printable(title))
        if self.current != stage:
            self.current = stage
            self.post_message(self.Changed())
