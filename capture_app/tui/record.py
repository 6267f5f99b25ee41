"""What the screen has heard of the rig so far: for views that open later, and for what runs over time."""

from collections import deque
from collections.abc import Callable, Iterable

from capture_app.node.operator.updates import LinkLost, Update
from capture_app.node.wire.status import RigStatus
from capture_app.node.wire.views import NewsLine, Preview

NEWS_KEPT = 500
PHASE_KEPT_S = 35.0


class RigRecord:
    """The latest status, the last news, and each camera's phase error over the last half minute."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """`clock`: seconds that only grow."""
        self.clock = clock
        self.status: RigStatus | None = None
        self.lost = ""
        """Why the leader does not answer; empty while it does."""
        self.news: deque[NewsLine] = deque(maxlen=NEWS_KEPT)
        self.phases: dict[str, deque[tuple[float, int | None]]] = {}
        """Of each camera its phase error in ns, from when on, by the clock; None: not known."""

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
            case Preview():
                pass

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
    found: list[int | None] = []
    steps = iter(phases)
    following = next(steps, None)
    value: int | None = None
    for time in times:
        while following is not None and following[0] <= time:
            value = following[1]
            following = next(steps, None)
        found.append(value)
    return found
