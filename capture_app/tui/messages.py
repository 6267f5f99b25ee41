"""What a rig tells, as messages of the screen: the app posts them to the screens that are open."""

from pathlib import Path

from textual.message import Message

from capture_app.node.operator.updates import LinkLost, Update
from capture_app.node.wire.status import RigStatus
from capture_app.node.wire.views import NewsLine, Preview


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
