"""What happened at the rig, with the time of the clock, newest at the bottom."""

from collections.abc import Iterable

from textual.containers import VerticalScroll

from capture_app.node.wire.views import NewsLine
from capture_app.tui.drawing.lines import Lines
from capture_app.tui.drawing.news import news_lines

SCROLLBAR = 1


class NewsPane(VerticalScroll, can_focus=True):
    """Follows the news unless the user has scrolled back."""

    def __init__(self) -> None:
        super().__init__(id="news")
        self.border_title = "news"
        self._lines = Lines()
        self._shown: tuple[NewsLine, ...] = ()

    def on_mount(self) -> None:
        """Put the lines in."""
        self.mount(self._lines)

    def draw(self, news: Iterable[NewsLine]) -> None:
        """Show the news."""
        self._shown = tuple(news)
        following = self.scroll_y >= self.max_scroll_y
        self._lines.show(news_lines(self._shown, self.size.width - SCROLLBAR))
        if following:
            self.call_after_refresh(self.scroll_end, animate=False)

    def on_resize(self) -> None:
        """Wrap anew."""
        self.draw(self._shown)
