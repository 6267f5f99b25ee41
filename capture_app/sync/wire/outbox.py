"""What a leader has to send, encoded when it leaves: time replies are stamped then, and go first."""

from collections import deque

from capture_app.sync.wire.codec import encode, reply_at, reply_before_t2
from capture_app.sync.wire.messages import ControlMessage, TimeRequest
from capture_app.sync.wire.version import version_answer

Address = tuple[str, int]


class Outbox:
    """Messages and where to; `now_ns` is the leader's clock."""

    def __init__(self) -> None:
        self._times: deque[tuple[bytes, Address]] = deque()
        self._messages: deque[tuple[ControlMessage, Address]] = deque()
        self._versions: deque[tuple[bytes, Address]] = deque()

    def send(self, message: ControlMessage, address: Address) -> None:
        """Send a message."""
        self._messages.append((message, address))

    def reply(self, request: TimeRequest, address: Address, now_ns: int) -> None:
        """Answer a time request that arrived at `now_ns`."""
        self._times.append((reply_before_t2(request, now_ns), address))

    def tell_version(self, data: bytes, address: Address) -> None:
        """Answer a datagram of another version with the version that is spoken here."""
        answer = version_answer(data)
        if answer is not None:
            self._versions.append((answer, address))

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams and where to; time replies carry `now_ns`, so send them at once."""
        datagrams = [(reply_at(before, now_ns), address) for before, address in self._times]
        self._times.clear()
        while self._messages:
            message, address = self._messages.popleft()
            datagrams.append((encode(message), address))
        datagrams.extend(self._versions)
        self._versions.clear()
        return datagrams
