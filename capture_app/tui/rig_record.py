"""What the rig has told so far.

What the screen has heard of the rig so far: for views that open later, and for what runs over time.

What a rig tells, as messages of the screen: the app posts them to the screens that are open.
"""

from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path

from textual.message import Message

from capture_app.node.rig_link import LinkLost, Update
from capture_app.node.wire.status import NewsLine, Preview, RigStatus

NEWS_KEPT = 500
PHASE_KEPT_S = 35.0


class RigRecord:
    """The latest status, the last news, and each camera's phase error over the last half minute."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """`clock`: seconds that only grow."""
        self.clock = clock
        self.status: RigStatus | None = None
        self.lost = ""
        """Why the leader does not answer; empty while it does."""
        self.news: deque[NewsLine] = deque(maxlen=NEWS_KEPT)
        self.phases: dict[str, deque[tuple[float, int | None]]] = {}
        """Of each camera its phase error in ns, from when on, by the clock; None: not known."""

    def add(self, update: Update) -> None:
        """Take note of an update."""
        match update:
            case RigStatus():
                self.status, self.lost = update, ""
                self._add_phases(update)
            case NewsLine():
                self.news.append(update)
            case LinkLost():
                self.lost = update.reason
            case Preview():
                pass

    def _add_phases(self, status: RigStatus) -> None:
        now = self.clock()
        names = {node.name for node in status.nodes}
        self.phases = {name: phases for name, phases in self.phases.items() if name in names}
        for node in status.nodes:
            phases = self.phases.setdefault(node.name, deque())
            if not phases or phases[-1][1] != node.phase_error_ns:
                phases.append((now, node.phase_error_ns))
            while len(phases) > 1 and phases[1][0] < now - PHASE_KEPT_S:
                phases.popleft()


def phases_at(phases: Iterable[tuple[float, int | None]], times: Iterable[float]) -> list[int | None]:
    """The phase error at each of these times, which grow; None before the first."""
    found: list[int | None] = []
    steps = iter(phases)
    following = next(steps, None)
    value: int | None = None
    for time in times:
        while following is not None and following[0] <= time:
            value = following[1]
            following = next(steps, None)
        found.append(value)
    return found


class StatusChanged(Message, bubble=False):
    """The rig is not as it was, or a screen opens and has not heard of it yet."""

    def __init__(self, status: RigStatus) -> None:
        super().__init__()
        self.status = status


class NewsReceived(Message, bubble=False):
    """Something happened."""

    def __init__(self, news: NewsLine) -> None:
        super().__init__()
        self.news = news


class PreviewReceived(Message, bubble=False):
    """A camera sees this."""

    def __init__(self, preview: Preview) -> None:
        super().__init__()
        self.preview = preview


class LinkChanged(Message, bubble=False):
    """The leader does not answer, for this reason; empty: it does again."""

    def __init__(self, reason: str) -> None:
        super().__init__()
        self.reason = reason


RigMessage = StatusChanged | NewsReceived | PreviewReceived | LinkChanged


def message_of(update: Update) -> RigMessage:
    """The message that tells an update."""
    match update:
        case RigStatus():
            return StatusChanged(update)
        case NewsLine():
            return NewsReceived(update)
        case Preview():
            return PreviewReceived(update)
        case LinkLost():
            return LinkChanged(update.reason)


class ModeRequested(Message):
    """A view asks for another mode: rig, shoot, sessions or jobs."""

    def __init__(self, mode: str) -> None:
        super().__init__()
        self.mode = mode


class SessionsRequested(Message):
    """A view asks to see the sessions of a folder, or one session in it."""

    def __init__(self, folder: Path, session: str | None = None) -> None:
        super().__init__()
        self.folder = folder
        self.session = session


class ShowSessions(Message, bubble=False):
    """The app tells the mode Sessions to show a folder, and one session in it where it is named."""

    def __init__(self, folder: Path, session: str | None) -> None:
        super().__init__()
        self.folder = folder
        self.session = session


class Mishap(Message):
    """An action failed: the shell shows why, and what to do, and keeps it in the news."""

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self.error = error
