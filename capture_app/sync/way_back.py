"""The way back to a better parent: looked for at a slow pace, and trusted once it has stayed a while."""

from capture_app.sync.messages import NOBODY, Heartbeat, Report, encode
from capture_app.sync.rounds import NEVER_NS
from capture_app.sync.state import NodeState

Address = tuple[str, int]

LOOK_EVERY_NS = 15_000_000_000
PROOFS, MOST_PROOFS = 4, 64
"""Looks in a row that a better parent has to answer: a minute at first, twice that whenever it fails soon."""
SOON = 4
"""One that then stays for less than so many times as long as it was waited for has failed soon."""
_LOOK = encode(Heartbeat(NOBODY, Report(state=NodeState.JOINING)))


class WayBack:
    """Which better parents answer, and for how long; `now_ns` is the node's own clock."""

    def __init__(self, parents: tuple[Address, ...]) -> None:
        self.due_ns = NEVER_NS
        self._parents = parents
        self._needed = dict.fromkeys(parents, PROOFS)
        self._proofs: dict[Address, int] = {}
        """Of those that were looked for last: how often each had answered in a row before."""
        self._answered: set[Address] = set()
        self._looks: list[Address] = []
        self._back_since_ns: int | None = None

    def follow(self, now_ns: int, *, back: bool = False) -> None:
        """A parent has taken this node in; `back` where it was looked for, not asked in turn."""
        self._back_since_ns = now_ns if back else None
        self._forget()
        self.due_ns = now_ns if len(self._parents) > 1 else NEVER_NS

    def lose(self, parent: Address, now_ns: int) -> None:
        """That parent is gone; nobody is looked for until there is another one."""
        if self._back_since_ns is not None:
            soon_ns = SOON * self._needed[parent] * LOOK_EVERY_NS
            soon = now_ns - self._back_since_ns < soon_ns
            self._needed[parent] = min(2 * self._needed[parent], MOST_PROOFS) if soon else PROOFS
        self._forget()
        self.due_ns = NEVER_NS

    def answered(self, address: Address) -> None:
        """Somebody who was looked for is there."""
        if address in self._proofs:
            self._answered.add(address)

    def look(self, parent: Address, now_ns: int, *, alone: bool) -> Address | None:
        """Look for all parents better than the present one; return one that has proven to be there.

        A parent that is alone, without any of its own, is worse than any other, and left at the first answer.
        """
        self.due_ns = now_ns + LOOK_EVERY_NS
        others = tuple(address for address in self._parents if address != parent)
        better = others if alone else self._parents[: self._parents.index(parent)]
        self._proofs = {a: self._proofs.get(a, 0) + 1 if a in self._answered else 0 for a in better}
        self._answered.clear()
        self._looks = list(better)
        return next((a for a in better if self._proofs[a] >= (1 if alone else self._needed[a])), None)

    def datagrams_to_send(self) -> list[tuple[bytes, Address]]:
        """Return what asks whether they are there; no leader takes whoever sends it for a client."""
        if not self._looks:
            return []
        looks, self._looks = self._looks, []
        return [(_LOOK, address) for address in looks]

    def _forget(self) -> None:
        self._proofs.clear()
        self._answered.clear()
        self._looks.clear()
