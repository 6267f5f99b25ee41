"""Staggered rigs: cameras that take their frames one after the other, each a planned delay after the instant.

Four cameras at 30 frames a second are then one at 120.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import Self

from capture_app.common.errors import BadInputError
from capture_app.common.names import is_name, natural_order
from capture_app.common.text import duration

EVEN, OFF = "even", "off"
MAX_DELAY_NS = 500_000_000
"""Maximum planned delay: the frames of a burst are selected within a second of its last instant."""


@dataclass(frozen=True, slots=True)
class Stagger:
    """Requested order of a rig's cameras: a delay for each, or even steps in the order of their names."""

    delays_ns: Mapping[str, int] | None = None
    """Delay of each named camera, 0 for the others; None: the k-th of N cameras has k/N of a period."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse `even`, or a delay for each camera: `cam0=0ms,cam1=8.3ms`. Raises BadInputError."""
        if text.strip() == EVEN:
            return cls()
        delays_ns: dict[str, int] = {}
        for part in text.split(","):
            name, _, delay = (piece.strip() for piece in part.partition("="))
            try:
                ms = float(delay.removesuffix("ms"))
            except ValueError:
                ms = -1.0
            if not (is_name(name) and isfinite(ms) and 0 <= ms * 1e6 <= MAX_DELAY_NS) or name in delays_ns:
                raise BadInputError(
                    f"{text!r} does not say how to stagger cameras",
                    hint=f"{EVEN}, or a delay of 0 to {duration(MAX_DELAY_NS)} for each, once:"
                    " cam0=0ms,cam1=8.3ms",
                )
            delays_ns[name] = round(ms * 1e6)
        return cls(delays_ns)

    @classmethod
    def parse_or_off(cls, text: str) -> Self | None:
        """Parse as `parse` does, and `off` as None. Raises BadInputError."""
        return None if text.strip() == OFF else cls.parse(text)

    def __str__(self) -> str:
        """Return the text that `parse` reads."""
        delays_ns = self.delays_ns
        return (
            EVEN
            if delays_ns is None
            else ",".join(f"{camera}={ns / 1e6}ms" for camera, ns in delays_ns.items())
        )

    def plan_ns(self, cameras: Collection[str], period_ns: int) -> dict[str, int]:
        """Return the planned delay in ns of each of these cameras in a rig with this frame period."""
        if self.delays_ns is not None:
            return {name: self.delays_ns.get(name, 0) for name in cameras}
        ordered = sorted(cameras, key=natural_order)
        return {name: place * period_ns // len(ordered) for place, name in enumerate(ordered)}


def describe_steps(delays_ns: Iterable[int]) -> str:
    """Describe the times between frames that follow each other: "steps of 8.33 ms"."""
    steps = [after - before for before, after in pairwise(sorted({*delays_ns}))]
    if not steps:
        return "no steps"
    # Even steps differ by a nanosecond where they do not divide the period.
    if max(steps) - min(steps) <= 1:
        return f"steps of {min(steps) / 1e6:.3g} ms"
    return f"steps of {min(steps) / 1e6:.3g} to {max(steps) / 1e6:.3g} ms"
