"""The latest news of a leader, for whoever looks at it later."""

import time
from collections import deque
from collections.abc import Callable

from capture_app.node.leader.wording import DiskNews, News, news_line
from capture_app.node.wire.status import BurstStatus
from capture_app.node.wire.views import Level, NewsLine
from capture_app.sync.foreign.app_leader import AppPhoneLost
from capture_app.sync.rig import events
from capture_app.sync.timekeeping.rate_jury import HostOffRate
from capture_app.trust.refusals import DatagramsRefused

KEPT = 500
_WARNINGS = events.NodeLost | events.BurstRefused | HostOffRate | DatagramsRefused | AppPhoneLost


class NewsLog:
    """Lines with the time of the calendar, each later than the one before."""

    def __init__(self, unix_now_ns: Callable[[], int] = time.time_ns, kept: int = KEPT) -> None:
        self._unix_now_ns = unix_now_ns
        self._lines: deque[NewsLine] = deque(maxlen=kept)

    def add(self, text: str, *, camera: str | None = None, level: Level = "info") -> None:
        """Add what happened now; what was just said is not said again."""
        last = self._lines[-1] if self._lines else None
        if last is not None and (last.text, last.camera) == (text, camera):
            return
        # A calendar clock may be set back.
        unix_ns = self._unix_now_ns() if last is None else max(self._unix_now_ns(), last.unix_ns + 1)
        self._lines.append(NewsLine(unix_ns=unix_ns, text=text, camera=camera, level=level))

    def note(self, news: News) -> None:
        """Add what happened in a rig where that is news; a burst's progress is in every status."""
        if isinstance(news, BurstStatus):
            if news.done:
                whole = news.session is not None and news.received == news.expected
                self.add(news_line(news), level="info" if whole else "warning")
        elif text := news_line(news):
            warns = isinstance(news, _WARNINGS)
            warns = warns or (isinstance(news, DiskNews) and bool(news.problem))
            self.add(text, camera=news.name, level="warning" if warns else "info")

    def after(self, unix_ns: int) -> tuple[NewsLine, ...]:
        """Return the lines that are later than that time, oldest first."""
        found: list[NewsLine] = []
        for line in reversed(self._lines):
            if line.unix_ns <= unix_ns:
                break
            found.append(line)
        return tuple(reversed(found))
