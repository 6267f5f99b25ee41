"""The delays of an emulated link; `delay_laws.h` draws them."""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class Delays:
    """One-way delays in us: `constant` is the minimum; `gamma` and `lognormal` have this mean in all.

    `shape` is that of the Gamma, or the sigma of the lognormal.
    """

    minimum_us: float
    mean_us: float
    law: str = "gamma"
    shape: float = 2.0

    def __str__(self) -> str:
        """Return the emulator's word for it."""
        if self.law == "constant":
            return f"constant,{self.minimum_us}"
        return f"{self.law},{self.minimum_us},{self.mean_us},{self.shape}"


TO_LEADER, TO_CLIENT = Delays(479.0, 1878.0), Delays(517.0, 1133.0)
"""WiFi as the paper measured it (Table III); the paper gives no law, Gamma of shape 2 is an assumption."""


@dataclass(frozen=True, slots=True)
class EmulatedLink:
    """A link between two ends, `NAMESPACE/DEVICE`, with the delays of its two directions."""

    OUTLIERS: ClassVar[tuple[str, ...]] = ("-o", "0.0064", "-u", "20000")
    """The share of frames that come up to 20 ms later still (the paper: 0.64 % over 10 ms)."""

    leader: str
    client: str
    to_leader: Delays = TO_LEADER
    to_client: Delays = TO_CLIENT

    def words(self) -> tuple[str, str, str, str]:
        """Return the emulator's words for it."""
        return self.leader, self.client, str(self.to_leader), str(self.to_client)

    def ways(self) -> tuple[tuple[str, Delays], tuple[str, Delays]]:
        """Return who receives, and with what delays, in the order of the emulator's reports."""
        return ("leader", self.to_leader), ("client", self.to_client)
