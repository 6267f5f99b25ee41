"""A view of the whole screen over a mode: a line that says what it is of, what it shows, and the keys."""

from textual.widget import Widget

from capture_app.tui.question import Dialog, Result
from capture_app.tui.widgets.footer import KeyFooter
from capture_app.tui.widgets.lines import Lines


class WholeScreen(Dialog[Result]):
    """Shows its parts between the line on top, which is `title_line`, and the keys."""

    DEFAULT_CSS = """
    WholeScreen { background: $background; }
    WholeScreen > .title { dock: top; height: 1; background: $panel; }
    """

    def __init__(self, *parts: Widget) -> None:
        self.title_line = Lines(classes="title")
        super().__init__(self.title_line, *parts, KeyFooter())
