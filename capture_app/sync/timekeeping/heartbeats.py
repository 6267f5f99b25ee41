"""When a node tells its leader that it is there, and since when it has heard nothing of that leader."""

from capture_app.sync.timekeeping.poll_schedule import AT_ONCE_NS, NEVER_NS

_MS = 1_000_000
HEARTBEAT_EVERY_NS = 500 * _MS
LEADER_SILENT_NS = 2500 * _MS


class Heartbeats:
    """Those of one node, from each time that a leader takes it in; local times in ns."""

    def __init__(self, every_ns: int | None, silent_ns: int) -> None:
        """Without `every_ns` none is sent by itself, and no silence is noticed."""
        self.due_ns = NEVER_NS
        """When the next one is to be sent."""
        self._every_ns, self._silent_ns = every_ns, silent_ns
        self._heard_ns = 0

    @property
    def are_regular(self) -> bool:
        """Whether they are sent by themselves."""
        return self._every_ns is not None

    @property
    def silent_from_ns(self) -> int:
        """From when on the leader is gone if it is not heard until then."""
        return NEVER_NS if self._every_ns is None else self._heard_ns + self._silent_ns

    def begin(self, now_ns: int) -> None:
        """A leader has taken the node in."""
        self._heard_ns = now_ns
        self.due_ns = NEVER_NS if self._every_ns is None else now_ns

    def heard(self, now_ns: int) -> None:
        """The leader has said something."""
        self._heard_ns = now_ns

    def send_at_once(self) -> None:
        """Have the next one sent without waiting."""
        self.due_ns = AT_ONCE_NS

    def sent(self, now_ns: int) -> None:
        """One was sent."""
        if self._every_ns is not None:
            self.due_ns = now_ns + self._every_ns
