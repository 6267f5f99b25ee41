"""One packet for all: radio cells in virtual time, and how the devices in them hear."""

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from capture_app.simulation.network.link import DelayLaw, Law

_US = 1_000
SLOT_NS = 9 * _US
SLOTS = 15
"""An access point waits for 0 to so many slots by chance before it sends (802.11, best effort)."""


WAY = DelayLaw(500 * _US, 1500 * _US, outlier_share=0.01)


@dataclass(frozen=True, slots=True)
class RadioCell:
    """An access point: from the leader until its packet is in the air takes as long for all who hear it."""

    name: str = "cell"
    delay: Law = WAY
    loss: float = 0.01
    copy_ns: int | None = None
    """The time that a packet takes, where each client is sent a copy of its own; None for one for all."""


@dataclass(frozen=True, slots=True)
class Ear:
    """How a device hears, in ns: a delay that is always the same, and an exponential one; some it misses."""

    constant_ns: int = 0
    jitter_ns: int = 5 * _US
    loss: float = 0.02


Ears = Mapping[str, tuple[RadioCell, Ear]]
"""Of each node by name, in the order in which copies go out."""


def heard(ears: Ears, true_ns: int, rng: random.Random) -> Iterator[tuple[str, int]]:
    """Yield who hears a packet that was sent at a true time in ns, and so much later, in ns."""
    left_ns: dict[RadioCell, int | None] = {}
    for name, (cell, ear) in ears.items():
        if cell not in left_ns:
            left_ns[cell] = None if rng.random() < cell.loss else cell.delay.draw(rng, true_ns)
        since_ns = left_ns[cell]
        if since_ns is None:
            continue
        if cell.copy_ns is not None:
            left_ns[cell] = since_ns + cell.copy_ns + rng.randint(0, SLOTS) * SLOT_NS
        heard_ns = since_ns + ear.constant_ns
        if ear.jitter_ns:
            heard_ns += round(rng.expovariate(1.0 / ear.jitter_ns))
        if rng.random() >= ear.loss:
            yield name, heard_ns
