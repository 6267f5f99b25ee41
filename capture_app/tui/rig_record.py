"""What the rig has told so far, for views that open later; and the messages between the app and its views."""

import math
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from msgspec.structs import replace
from textual.message import Message
from textual.widget import Widget

from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.protocol.status import NewsLine, RigStatus
from capture_app.rig.link import LinkLost, Update

NEWS_KEPT = 500
PHASE_KEPT_S = 35.0


@dataclass(slots=True)
class RigRecord:
    """The latest status, the last news, and each camera's phase error over the last half minute."""

    clock: Callable[[], float] = time.monotonic
    """Seconds that only grow."""
    status: RigStatus | None = None
    lost: str = ""
    """Why the leader does not answer; empty while it does."""
    news: deque[NewsLine] = field(default_factory=lambda: deque(maxlen=NEWS_KEPT))
    phases: dict[str, deque[tuple[float, int | None]]] = field(default_factory=dict)
    """Each camera's phase errors in ns, with the time of the clock from which on; None: not known."""

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
                if self.status is not None:
                    # What it told last holds no more: of a leader that is gone one thing is said.
                    gone = (replace(node, state=NodeState.LOST, message="") for node in self.status.nodes)
                    self.status = replace(self.status, nodes=tuple(gone), advice="", message="")

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
    steps = [(-math.inf, None), *phases]
    since = [when for when, _ in steps]
    return [steps[bisect_right(since, moment) - 1][1] for moment in times]


@dataclass
class Told(Message, bubble=False):
    """Something that is shown is not as it was: the rig, its link or its news, a picture, the runs."""

    what: object
    """An update of the rig, or the runs."""


@dataclass
class SessionsRequested(Message):
    """A view asks to see the sessions of a folder."""

    folder: Path


@dataclass
class Mishap(Message):
    """An action failed: the shell shows why, and what to do, and keeps it in the news."""

    error: Exception


@contextmanager
def telling(widget: Widget) -> Iterator[None]:
    """Let a view say on the screen what goes wrong in a block, and go on after it."""
    try:
        yield
    except SimulshotError as error:
        widget.post_message(Mishap(error))
