"""Log of a process of a rig: the lines that the terminal and the screen show."""

import time
from collections import Counter, deque
from collections.abc import Callable

from capture_app.common import system
from capture_app.common.bounds import cut
from capture_app.protocol.event_text import RigEvent, leader_line, leader_record
from capture_app.protocol.status import BurstStatus, Level, LogLine

MAX_LOG_LINES = 500
MAX_LETTERS = 1000
RATE_WINDOW_S = 10.0
MAX_LINES_A_NODE, MAX_LINES_OF_NODES = 30, 300
"""Maximum number of lines within RATE_WINDOW_S about one node, and about all of them."""


class Log:
    """Log of lines with strictly increasing calendar times, shown as they arrive."""

    def __init__(
        self,
        show: Callable[[str], None] = lambda _: None,
        *,
        name: str | None = None,
        record: Callable[[dict[str, object]], None] | None = None,
    ) -> None:
        """`show` displays a line to the operator; `record` receives the rig's events for JSON.

        `name` is the node that the lines are about; None for a leader's log, which covers all its nodes.
        """
        self.show, self._record, self.name = show, record, name
        self.title_of: Callable[[str], str] = str
        """What people call a node of that name."""
        self._lines: deque[LogLine] = deque(maxlen=MAX_LOG_LINES)
        self._window_s = -RATE_WINDOW_S
        self._lines_of: Counter[str] = Counter()
        """Number of lines about each node since the window began."""

    def say(self, text: str, *, camera: str | None = None, level: Level = "info") -> None:
        """Add a line, about that camera or the log's node, and show it."""
        if text := self._admitted(text, camera):
            self.add(text, camera=camera or self.name, level=level)
            self.show(text)

    def say_once(self, text: str) -> None:
        """Add and show a line, unless the log still has it."""
        if all(line.text != text for line in self._lines):
            self.say(text)

    def _admitted(self, text: str, camera: str | None) -> str:
        """Return the line to log, cut to the maximum length; empty if the node `camera` logs too many."""
        now_s = system.monotonic_s()
        if now_s - self._window_s >= RATE_WINDOW_S:
            self._window_s = now_s
            self._lines_of.clear()
        if camera is not None:
            if self._lines_of[camera] == MAX_LINES_A_NODE or self._lines_of.total() == MAX_LINES_OF_NODES:
                return ""
            self._lines_of[camera] += 1
            if self._lines_of[camera] == MAX_LINES_A_NODE:
                return (
                    f"{self.title_of(camera)}: its further lines are left out for up to {RATE_WINDOW_S:.0f} s"
                )
        return cut(text, MAX_LETTERS)

    def add(self, text: str, *, camera: str | None = None, level: Level = "info") -> None:
        """Add a line with the current time, unless it repeats the last one."""
        text = cut(text, MAX_LETTERS)
        last = self._lines[-1] if self._lines else None
        if last is not None and (last.text, last.camera) == (text, camera):
            return
        # The calendar clock may be set back.
        unix_ns = time.time_ns() if last is None else max(time.time_ns(), last.unix_ns + 1)
        self._lines.append(LogLine(unix_ns=unix_ns, text=text, camera=camera, level=level))

    def after(self, unix_ns: int) -> tuple[LogLine, ...]:
        """Return the lines later than a time, oldest first."""
        return tuple(line for line in self._lines if line.unix_ns > unix_ns)

    def say_of_disk(self, name: str | None, problem: str) -> None:
        """Log that a disk became unusable or usable again: the named node's, or the leader's."""
        self.say(
            f"{self.title_of(name) if name else 'leader'}: {problem or 'its disk is usable again'}",
            camera=name,
            level="warning" if problem else "info",
        )

    def note(self, event: RigEvent) -> None:
        """Show an event and add it to the log, except a burst's progress, which is in every status."""
        text, is_warning = leader_line(event, self.title_of)
        camera = None if isinstance(event, BurstStatus) else event.name
        if text:
            if not (text := self._admitted(text, camera)):
                return
            if not isinstance(event, BurstStatus) or event.done:
                self.add(text, camera=camera, level="warning" if is_warning else "info")
            self.show(text)
        if self._record is not None:
            self._record(leader_record(event))
