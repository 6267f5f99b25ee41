"""A table or figure of the paper with our numbers beside it, by the names in `values`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.paper.values import PaperFigure, PaperTable


@dataclass(frozen=True, slots=True)
class Measured:
    """Our numbers in one set-up, by the paper's names; unmeasured ones are left out."""

    values: Mapping[str, float]
    trials: int
    setup: str
    """Difference between protocol and default as a clause, such as "tolerance 20 us"."""


@dataclass(frozen=True, slots=True)
class Reproduction:
    """A table or figure of the paper with our numbers, at the paper's protocol and by default.

    Raises ValueError for a name that the table does not have, and for a figure without a drawing.
    """

    of: PaperTable
    protocol: Measured
    default: Measured | None
    """Numbers without any option (default tolerances, no delay of a trigger).

    None if there is nothing to choose, so that the protocol's numbers are also the default's.
    """
    simulated: str
    """Simulated parts, as a sentence."""
    given: tuple[str, ...] = ()
    """Names of numbers that are inputs of the model, so that they agree by construction."""
    notes: tuple[str, ...] = ()
    """Notes as sentences, such as differences from the paper and their reasons."""
    draw: Callable[[Path], Path] | None = None
    """Draws a figure into a given file, and returns the file."""
    suffix: str = ".png"
    """File suffix of the picture."""

    def __post_init__(self) -> None:
        """Check the names."""
        measured = [self.protocol.values, {} if self.default is None else self.default.values, self.given]
        unknown = {name for names in measured for name in names} - set(self.of.names)
        if unknown:
            raise ValueError(f"{self.of.key} has no {', '.join(sorted(unknown))}")
        if isinstance(self.of, PaperFigure) and self.draw is None:
            raise ValueError(f"{self.of.key} is a figure and needs a drawing")
