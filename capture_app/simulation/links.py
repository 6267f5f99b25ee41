"""Network links in virtual time: laws of one-way delays, and loss; true times are the simulation's.

A link with a memory, as WiFi has it, gives each node that opens it a channel of its own.
"""

import random
from dataclasses import dataclass
from typing import Literal, Protocol


class DelayLaw(Protocol):
    """A law of one-way delays."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay in ns of one datagram sent at a true time in ns."""


@dataclass(frozen=True, slots=True)
class ReplayedDelay:
    """Recorded delays in ns, a new one each `every_ns` of true time, over and over, from `start` on."""

    delays_ns: tuple[int, ...]
    every_ns: int
    start: int = 0

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay that was recorded at that time, in ns."""
        return self.delays_ns[(self.start + true_ns // self.every_ns) % len(self.delays_ns)]


Direction = Literal["to_leader", "to_client"]


class Channel(Protocol):
    """A link in use by one node."""

    def deliveries(self, direction: Direction, true_ns: int, rng: random.Random) -> list[int]:
        """Return the delays in ns at which copies of one datagram arrive: none, one or two."""


@dataclass(frozen=True, slots=True)
class Link:
    """A link between a client and its leader; datagrams can overtake each other."""

    to_leader: DelayLaw
    to_client: DelayLaw
    loss: float = 0.0
    duplication: float = 0.0

    def open(self) -> Channel:
        """Return the link as one node uses it from now on."""
        return self

    def deliveries(self, direction: Direction, true_ns: int, rng: random.Random) -> list[int]:
        """See `Channel.deliveries`."""
        if rng.random() < self.loss:
            return []
        copies = 2 if rng.random() < self.duplication else 1
        law = self.to_leader if direction == "to_leader" else self.to_client
        return [law.draw(rng, true_ns) for _ in range(copies)]
