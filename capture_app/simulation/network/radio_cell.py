"""Broadcasts in virtual time: radio cells, and when the devices in them receive a packet."""

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from capture_app.simulation.network.delay_laws import DelayLaw, GammaDelay

_US = 1_000
SLOT_NS = 9 * _US
SLOTS = 15
"""An access point waits for 0 to so many slots by chance before it sends (802.11, best effort)."""
USUAL_DELAY = GammaDelay(500 * _US, 1500 * _US, outlier_share=0.01)


@dataclass(frozen=True, slots=True)
class RadioCell:
    """An access point; a packet takes the same time from the leader into the air for all receivers."""

    name: str = "cell"
    delay: DelayLaw = USUAL_DELAY
    loss: float = 0.01
    copy_ns: int | None = None
    """Airtime of a packet, where each client is sent a copy of its own; None for one packet for all."""


@dataclass(frozen=True, slots=True)
class Receiver:
    """A device's delay of reception in ns: a constant and an exponential part; some packets are lost."""

    constant_ns: int = 0
    jitter_ns: int = 5 * _US
    loss: float = 0.02


Receivers = Mapping[str, tuple[RadioCell, Receiver]]
"""Cell and receiver of each node by name, in the order in which copies go out."""


def deliver_broadcast(receivers: Receivers, true_ns: int, rng: random.Random) -> Iterator[tuple[str, int]]:
    """Yield the nodes that receive a packet sent at a true time in ns, and the delay of each in ns."""
    left_ns: dict[RadioCell, int | None] = {}
    for name, (cell, receiver) in receivers.items():
        if cell not in left_ns:
            left_ns[cell] = None if rng.random() < cell.loss else cell.delay.draw(rng, true_ns)
        since_ns = left_ns[cell]
        if since_ns is None:
            continue
        if cell.copy_ns is not None:
            left_ns[cell] = since_ns + cell.copy_ns + rng.randint(0, SLOTS) * SLOT_NS
        delay_ns = since_ns + receiver.constant_ns
        if receiver.jitter_ns:
            delay_ns += round(rng.expovariate(1.0 / receiver.jitter_ns))
        if rng.random() >= receiver.loss:
            yield name, delay_ns
