"""Two-way time messages over a simulated link, without the rest of a rig: samples for a clock filter."""

import random
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from capture_app.simulation.link import Channel, Link
from capture_app.sync.clock import ClockSample

TURNAROUND_NS = 30_000
"""From the receipt of a request to the reply, at the leader."""
START_TRUE_NS = 10**12


class LocalClock(Protocol):
    """A client's clock, steady or not."""

    def local_from_true(self, true_ns: int) -> int:
        """Reading of this clock in ns at a true time in ns."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """A sample and the true time in ns at which its reply arrived; the leader's clock is the true time."""

    sample: ClockSample
    arrived_true_ns: int
    there_ns: int
    back_ns: int


def exchanges(
    link: Link, clock: LocalClock, rng: random.Random, *, count: int, pace_ns: int
) -> list[Exchange]:
    """Send `count` requests, one each `pace_ns`, and return those that came back, in the order they did.

    A duplicated datagram counts when it first arrives, as in the engine.
    """
    return exchanges_at(link, clock, rng, range(START_TRUE_NS, START_TRUE_NS + count * pace_ns, pace_ns))


def exchanges_at(
    link: Link, clock: LocalClock, rng: random.Random, sent_true_ns: Iterable[int]
) -> list[Exchange]:
    """Send a request at each of these true times in ns; return what comes back as `exchanges` does."""
    return sorted(_sent(link, clock, rng, sent_true_ns), key=lambda e: e.arrived_true_ns)


def _sent(
    link: Link, clock: LocalClock, rng: random.Random, sent_true_ns: Iterable[int]
) -> Iterator[Exchange]:
    channel = Channel(link)
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
            yield Exchange(sample, t3_ns, min(there), min(back))
