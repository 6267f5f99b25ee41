"""Datagrams that were refused: counted, and told now and then, however many come."""

from dataclasses import dataclass

from capture_app.trust.sealing import Refused

TELL_EVERY_NS = 10_000_000_000
FEW = 10
"""Fewer that came twice, or with a key of before the leader was started anew, are nobody's doing."""
MOST_KINDS = 32
"""So many places and reasons are told apart between two tellings."""


@dataclass(frozen=True, slots=True)
class DatagramsRefused:
    """So many datagrams from a host were not taken in since this was told last, and why."""

    host: str
    why: Refused
    count: int

    @property
    def name(self) -> None:
        """No camera's: whose they are is not known."""

    def __str__(self) -> str:
        what = "a datagram" if self.count == 1 else f"{self.count} datagrams"
        return f"refused {what} from {self.host}: {self.why}"


class Refusals:
    """What was refused; `now_ns` is the node's own clock."""

    def __init__(self) -> None:
        self.total = 0
        self._counts: dict[tuple[str, Refused], int] = {}
        self._due_ns: int | None = None

    def add(self, host: str, why: Refused) -> None:
        """Count a datagram."""
        self.total += 1
        key = host, why
        if key not in self._counts and len(self._counts) >= MOST_KINDS:
            key = "other hosts", why
        self._counts[key] = self._counts.get(key, 0) + 1

    def take_news(self, now_ns: int) -> list[DatagramsRefused]:
        """Return what was refused since the last time, if that is long enough ago."""
        if self._due_ns is not None and now_ns < self._due_ns:
            return []
        told = [
            (host, why)
            for (host, why), count in self._counts.items()
            if count >= FEW or why not in (Refused.UNKNOWN_KEY, Refused.REPLAYED)
        ]
        if told:
            self._due_ns = now_ns + TELL_EVERY_NS
        return [DatagramsRefused(*key, self._counts.pop(key)) for key in told]
