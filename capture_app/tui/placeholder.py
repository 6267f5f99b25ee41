"""A mode that is not built yet."""

from textual.app import ComposeResult
from textual.widgets import Static

from capture_app.tui.mode import ModeView


class NotThereYet(ModeView):
    """Says so."""

    def __init__(self, title: str) -> None:
        super().__init__()
        self._title = title

    def compose(self) -> ComposeResult:
        """One sentence."""
        yield Static(f"{self._title} is not there yet; capture-app's commands do its work.", classes="notice")
