"""Log lines for events at a leader or a relay, used by the terminal and the screen."""

import re
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from capture_app.common.address import Address
from capture_app.common.bounds import cut
from capture_app.common.text import duration
from capture_app.protocol.status import BurstStatus, Level, LogLine
from capture_app.sync.rig import events, status_text
from capture_app.sync.rig.time_client import TimeClientEvent
from capture_app.sync.timekeeping import clock_events
from capture_app.sync.timekeeping.rates import HostOffRate
from capture_app.trust.sealing import DatagramsRefused

_NODE_LINES = {
    "joined": "{0.name} joined",
    "returned": "{0.name} is back",
    "lost": "lost {0.name}: {0.reason}",
    "forgotten": "forgot {0.name}, which was lost",
    "moved": "{0.name} is now connected to {1}",
    "refused": "refused {0.name} {0.where}: {0.reason}",
}
MAX_LOG_LINES = 500
MAX_LETTERS = 1000
RATE_WINDOW_S = 10.0
MAX_LINES_A_NODE, MAX_LINES_OF_NODES = 30, 300
"""Maximum number of lines within RATE_WINDOW_S about one node, and about all of them."""


@dataclass(frozen=True, slots=True)
class FollowerEvent:
    """Event of one follower, or of all of them, as a line for people."""

    name: str | None
    line: str
    is_warning: bool = False
    """Whether it needs attention."""


RigEvent = events.LeaderEvent | HostOffRate | DatagramsRefused | BurstStatus | FollowerEvent
"""Events that a leader logs: nodes and phones that come and go, clock problems, damaged seals, and bursts."""


def event_line(event: RigEvent) -> tuple[str, bool]:
    """Return a line for people about an event, and whether it needs attention.

    The line is empty if the event is not worth one.
    """
    match event:
        case events.NodeChanged(change=change, where=where):
            return _NODE_LINES[change].format(event, where or "this leader"), change in ("lost", "refused")
        case events.TriggerAnswered(name, burst, refusal):
            return f"burst {burst}: without {name}: {refusal}" if refusal else "", True
        case HostOffRate():
            return off_rate_line(event), bool(event.fast_ppm)
        case FollowerEvent():
            return event.line, event.is_warning
        case DatagramsRefused():
            return str(event), True
        case BurstStatus():
            return burst_line(event), event.session is None or event.received != event.expected


def off_rate_line(off: HostOffRate) -> str:
    """Return a line on a clock at an unusual rate and possible causes, or on its return to the baseline."""
    if not off.fast_ppm:
        return f"the clock of {off.name or 'the leader'} runs at its normal rate again"
    if off.certain:
        return status_text.slewing(off.name or "the leader's host", off.fast_ppm)
    against = "the leader's" if off.ambiguous else "all others"
    return (
        f"the clock of {off.name or 'the leader'} runs {status_text.fast_or_slow(off.fast_ppm)} against"
        f" {against}: its NTP daemon is slewing it, or it is a virtual machine"
        + (" (or the leader's clock is)" if off.ambiguous else "")
    )


def follower_line(event: TimeClientEvent, parent: Address) -> str:
    """Return a line about a relay's connection to its own leader; empty if there is nothing to log."""
    match event:
        case events.Joined():
            return f"joined {parent}"
        case events.LeaderNotice("lost"):
            return f"lost {parent} ({event.text}): in holdover"
        case events.LeaderNotice("said"):
            return f"{parent} says: {event.text}"
        case events.LeaderNotice():
            return f"{parent} refused this relay: {event.text}"
        case clock_events.ClockSynced():
            return f"ready: clock error at most {duration(event.time_map.hard_bound_ns)}"
    return status_text.of_event(event)


def burst_line(burst: BurstStatus) -> str:
    """Return a line on a burst's progress."""
    if not burst.burst:
        return burst.message
    text = f"burst {burst.burst}: {burst.received} of {burst.expected} images"
    if burst.done:
        text += f", saved as {burst.session}" if burst.session else ", no session"
    return ("; " if burst.done else ", ").join(filter(None, (text, burst.message)))


def event_record(event: RigEvent) -> dict[str, object]:
    """Return the fields of an event for its line of JSON."""
    match event:
        case events.NodeChanged(name, change, reason, where):
            fields: dict[str, dict[str, object]] = {
                "moved": {"relay": where or None},
                "refused": {"where": where, "reason": reason},
                "lost": {"reason": reason},
            }
            return {"event": f"node-{change}", "name": name, **fields.get(change, {})}
        case events.TriggerAnswered(name, burst, refusal=""):
            return {"event": "burst-accepted", "name": name, "burst": burst}
        case events.TriggerAnswered(name, burst, refusal):
            return {"event": "burst-refused", "name": name, "burst": burst, "reason": refusal}
        case HostOffRate(name, fast_ppm=0.0):
            return {"event": "host-at-rate", "name": name}
    kind = re.sub(r"(?<!^)(?=[A-Z])", "-", type(event).__name__).lower()
    return {"event": kind, **msgspec.to_builtins(event)}


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
        self._lines: deque[LogLine] = deque(maxlen=MAX_LOG_LINES)
        self._window_s = -RATE_WINDOW_S
        self._lines_of: Counter[str] = Counter()
        """Number of lines about each node since the window began."""

    def say(self, text: str, *, camera: str | None = None, level: Level = "info") -> None:
        """Add a line, about that camera or the log's node, and show it."""
        if text := self._admitted(text, camera):
            self.add(text, camera=camera or self.name, level=level)
            self.show(text)

    def _admitted(self, text: str, camera: str | None) -> str:
        """Return the line to log, cut to the maximum length; empty if the node `camera` logs too many."""
        now_s = time.monotonic()
        if now_s - self._window_s >= RATE_WINDOW_S:
            self._window_s = now_s
            self._lines_of.clear()
        if camera is not None:
            if self._lines_of[camera] == MAX_LINES_A_NODE or self._lines_of.total() == MAX_LINES_OF_NODES:
                return ""
            self._lines_of[camera] += 1
            if self._lines_of[camera] == MAX_LINES_A_NODE:
                return f"{camera}: its further lines are left out for up to {RATE_WINDOW_S:.0f} s"
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
            f"{name or 'leader'}: {problem or 'its disk is usable again'}",
            camera=name,
            level="warning" if problem else "info",
        )

    def note(self, event: RigEvent) -> None:
        """Show an event and add it to the log, except a burst's progress, which is in every status."""
        text, is_warning = event_line(event)
        camera = None if isinstance(event, BurstStatus) else event.name
        if text:
            if not (text := self._admitted(text, camera)):
                return
            if not isinstance(event, BurstStatus) or event.done:
                self.add(text, camera=camera, level="warning" if is_warning else "info")
            self.show(text)
        if self._record is not None:
            self._record(event_record(event))
