"""Base class of whole-screen views over a mode."""

from textual.widget import Widget

from capture_app.tui.widgets.dialog import Dialog, Result
from capture_app.tui.widgets.key_footer import KeyFooter
from capture_app.tui.widgets.lines import Lines


class WholeScreen(Dialog[Result]):
    """Screen with its parts between the title line, `title_line`, and the key footer."""

    DEFAULT_CSS = """
    WholeScreen { background: $background; }
    WholeScreen > .title { dock: top; height: 1; background: $panel; }
    """

    def __init__(self, *parts: Widget) -> None:
        self.title_line = Lines(classes="title")
        super().__init__(self.title_line, *parts, KeyFooter(id="footer"))
