"""The line below the mode Shoot: what is under way, else why nothing came of it, else how good things are."""

from textual.content import Content

from capture_app.node.wire.status import BurstStatus
from capture_app.text import printable
from capture_app.tui.drawing.lines import Lines
from capture_app.tui.shoot.take import Take

SAID_AFTER_S = 2
"""A take without news for so long says for how long."""


class StatusLine(Lines):
    """Keeps on the screen whatever the user waits for until it is there or has failed."""

    DEFAULT_CSS = "StatusLine { height: 1; padding: 0 1; }"

    def __init__(self) -> None:
        super().__init__(id="shoot-advice")
        self.moment = ""
        """The countdown, or the take that is just ordered."""
        self.waiting = ""
        """What keeps an order from being a take."""
        self.failure = ""
        """Why the last order came to nothing."""

    def show_course(self, take: Take | None, now_s: float, otherwise: Content) -> None:
        """Show what is under way, of the newest take too; where nothing is, what else there is to say."""
        line = otherwise
        if self.waiting:
            line = Content.styled(f"◔ esc cancels; {printable(self.waiting)}", "bold $primary")
        elif self.moment:
            line = Content.styled(f"◉ {printable(self.moment)}", "bold $primary")
        elif take is not None and not take.status.done:
            text = f"◔ {printable(take.name)}: {progress_words(take.status, now_s - take.begun_s)}"
            line = Content.styled(text, "bold $primary")
        elif self.failure:
            line = Content.styled(f"! no take: {printable(self.failure)}", "bold $warning")
        self.show([line.truncate(max(self.size.width, 1), ellipsis=True)])


def progress_words(status: BurstStatus, seconds: float) -> str:
    """How far a burst is that was ordered so many seconds ago."""
    if status.recording and not status.done:
        lacking = f", {status.expected - status.received} on their way" if status.expected else ""
        return f"recording: {status.received} frames{lacking}; Space ends it"
    after = f", {seconds:.0f} s" if seconds >= SAID_AFTER_S else ""
    if status.received:
        return f"{status.received} of {status.expected} images"
    if status.message or not status.expected:
        return f"{printable(status.message) or 'ordered'}{after}"
    return f"taken; cameras are saving{after}"
