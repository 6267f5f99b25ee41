"""Network links in virtual time: one-way delays drawn from a law, loss and duplication."""

import random
from dataclasses import dataclass

_US = 1_000


@dataclass(frozen=True, slots=True)
class DelayLaw:
    """One-way delay = minimum + Gamma(shape) of the mean given, times in ns; some come much later."""

    minimum_ns: int
    mean_ns: int
    shape: float = 2.0
    outlier_share: float = 0.0
    outlier_ns: int = 20_000_000

    def draw(self, rng: random.Random) -> int:
        """Return the delay of one datagram, in ns."""
        delay_ns = self.minimum_ns + rng.gammavariate(self.shape, (self.mean_ns - self.minimum_ns) / self.shape)
        if rng.random() < self.outlier_share:
            delay_ns += rng.random() * self.outlier_ns
        return round(delay_ns)


@dataclass(frozen=True, slots=True)
class Link:
    """A link between a client and its leader; datagrams overtake each other as their delays will."""

    to_leader: DelayLaw
    to_client: DelayLaw
    loss: float = 0.0
    duplication: float = 0.0

    def deliveries(self, law: DelayLaw, rng: random.Random) -> list[int]:
        """Return the delays in ns at which copies of one datagram arrive: none, one or two."""
        if rng.random() < self.loss:
            return []
        copies = 2 if rng.random() < self.duplication else 1
        return [law.draw(rng) for _ in range(copies)]


PAPER_LINK = Link(
    to_leader=DelayLaw(479 * _US, 1878 * _US, outlier_share=0.0064),
    to_client=DelayLaw(517 * _US, 1133 * _US, outlier_share=0.0064),
)
"""WiFi as the paper measured it (section 4); the Gamma shape is an assumption."""
