"""Record of the rig's updates for views that open later, and the messages between the app and its views."""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path

from msgspec.structs import replace
from textual.message import Message
from textual.widget import Widget

from capture_app.common import system
from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.common.text import printable
from capture_app.protocol.status import LogLine, RigStatus
from capture_app.rig.instant_previews import LeaderMoments
from capture_app.rig.rig_link import LinkLost, Update

MAX_LOG_LINES = 500
PHASE_HISTORY_S = 35.0


@dataclass(slots=True)
class RigRecord:
    """Latest status, newest log lines, and each camera's phase error over the last half minute."""

    clock: Callable[[], float] = system.monotonic_s
    """Monotonic clock, in seconds."""
    status: RigStatus | None = None
    lost: str = ""
    """Reason why the leader does not answer; empty while it does."""
    ending: str = ""
    """What the screen waits for before it stops the rig; empty if it does not."""
    _moments: LeaderMoments = field(default_factory=LeaderMoments)
    log: deque[LogLine] = field(default_factory=lambda: deque(maxlen=MAX_LOG_LINES))
    phases: dict[str, deque[tuple[float, int | None]]] = field(default_factory=dict)
    """Phase errors (ns) by camera, each with the time from which it holds; None if unknown."""

    def add(self, update: Update) -> None:
        """Store an update."""
        match update:
            case RigStatus():
                self.status, self.lost = update, ""
                self._moments.hear(update.now_ns, round(self.clock() * 1e9))
                self._add_phases(update)
            case LogLine():
                self.log.append(update)
            case LinkLost():
                self.lost, self._moments = update.reason, LeaderMoments()
                if self.status is not None:
                    # The leader's last advice and messages are obsolete; only its loss is reported.
                    gone = (replace(node, state=NodeState.LOST, message="") for node in self.status.nodes)
                    self.status = replace(self.status, nodes=tuple(gone), advice="", message="")

    def title(self, camera: str) -> str:
        """Return what people call a camera, printable."""
        return printable(camera if self.status is None else self.status.titles.get(camera, camera))

    def moment_s(self, leader_ns: int | None) -> float:
        """Return a leader time by `clock`, in seconds, too late by a message's time; now if it is unknown."""
        return 1e-9 * self._moments.here_ns(leader_ns, round(self.clock() * 1e9))

    def _add_phases(self, status: RigStatus) -> None:
        now = self.clock()
        self.phases = {node.name: self.phases.get(node.name, deque()) for node in status.nodes}
        for node in status.nodes:
            phases = self.phases[node.name]
            if not phases or phases[-1][1] != node.phase_error_ns:
                phases.append((now, node.phase_error_ns))
            while len(phases) > 1 and phases[1][0] < now - PHASE_HISTORY_S:
                phases.popleft()


def phases_at(phases: Iterable[tuple[float, int | None]], times: Iterable[float]) -> list[int | None]:
    """Return the phase error at each of these increasing times; None before the first one."""
    steps = [(-math.inf, None), *phases]
    return [steps[bisect_right(steps, moment, key=itemgetter(0)) - 1][1] for moment in times]


@dataclass
class RecordChanged(Message, bubble=False):
    """Message to views: a status, a log line, the link, a preview or a run has changed."""

    what: object
    """Update of the rig, or the runs."""


@dataclass
class SessionsRequested(Message):
    """Request to show the sessions of a folder."""

    folder: Path


@dataclass
class SessionMoved(Message):
    """A session was renamed, trashed or restored; `after` is its folder now, None in the trash."""

    before: Path
    after: Path | None


@dataclass
class ActionFailed(Message):
    """Failed action; the app shows the reason and the remedy, and adds them to the log."""

    error: Exception


@contextmanager
def showing_errors(widget: Widget) -> Iterator[None]:
    """Show errors of a block on the screen, and continue after it."""
    try:
        yield
    except SimulshotError as error:
        widget.post_message(ActionFailed(error))
