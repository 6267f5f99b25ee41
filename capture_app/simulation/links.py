"""Network links in virtual time: distributions of one-way delays, and loss; times are true times.

A link with memory, such as WiFi, gives each node that opens it its own channel.
"""

import random
from dataclasses import dataclass
from typing import Literal, Protocol


class DelayLaw(Protocol):
    """A distribution of the one-way delays of datagrams."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay in ns of one datagram sent at a true time in ns."""


@dataclass(frozen=True, slots=True)
class ReplayedDelay:
    """Recorded delays in ns, one for each `every_ns` of true time, in a loop from index `start`."""

    delays_ns: tuple[int, ...]
    every_ns: int
    start: int = 0

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay recorded for that time, in ns."""
        return self.delays_ns[(self.start + true_ns // self.every_ns) % len(self.delays_ns)]


Direction = Literal["to_leader", "to_client"]


class Channel(Protocol):
    """A link as one node uses it."""

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
        """Return a channel of this link for one node."""
        return self

    def deliveries(self, direction: Direction, true_ns: int, rng: random.Random) -> list[int]:
        """Return the delays of a datagram's copies; see `Channel.deliveries`."""
        if rng.random() < self.loss:
            return []
        copies = 2 if rng.random() < self.duplication else 1
        law = self.to_leader if direction == "to_leader" else self.to_client
        return [law.draw(rng, true_ns) for _ in range(copies)]
