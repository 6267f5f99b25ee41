"""Network links in virtual time: distributions of one-way delays, loss, and time messages over them.

Times are true times. A link with memory, such as WiFi, gives each node that opens it its own channel.
"""

import random
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, Protocol

from capture_app.sync.clock.clock_filter import ClockSample

TURNAROUND_NS = 30_000
"""Time that a leader takes from the receipt of a request to the reply."""
START_TRUE_NS = 10**12


class DelayLaw(Protocol):
    """A distribution of the one-way delays of datagrams."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay in ns of one datagram sent at a true time in ns."""


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


class LocalClock(Protocol):
    """A client's clock, with or without drift."""

    def local_from_true(self, true_ns: int) -> int:
        """Return this clock's reading in ns at a true time in ns."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """A sample and the true time in ns at which its reply arrived; the leader's clock is the true time."""

    sample: ClockSample
    arrived_true_ns: int
    there_ns: int
    back_ns: int


def exchanges(
    link: Link, clock: LocalClock, rng: random.Random, *, count: int, poll_interval_ns: int
) -> list[Exchange]:
    """Send a request every `poll_interval_ns`; return the completed exchanges in order of arrival.

    The first copy of a duplicated datagram counts, as in the engine.
    """
    return exchanges_at(
        link, clock, rng, range(START_TRUE_NS, START_TRUE_NS + count * poll_interval_ns, poll_interval_ns)
    )


def exchanges_at(
    link: Link, clock: LocalClock, rng: random.Random, sent_true_ns: Iterable[int]
) -> list[Exchange]:
    """Send a request at each of these true times in ns; return completed exchanges as `exchanges` does."""
    channel, found = link.open(), []
    for sent_ns in sent_true_ns:
        there = channel.deliveries("to_leader", sent_ns, rng)
        if not there:
            continue
        t1_ns = sent_ns + min(there)
        t2_ns = t1_ns + TURNAROUND_NS
        back = channel.deliveries("to_client", t2_ns, rng)
        if back:
            t3_ns = t2_ns + min(back)
            local_ns = clock.local_from_true(sent_ns), clock.local_from_true(t3_ns)
            sample = ClockSample(local_ns[0], t1_ns, t2_ns, local_ns[1])
            found.append(Exchange(sample, t3_ns, min(there), min(back)))
    return sorted(found, key=lambda e: e.arrived_true_ns)
