"""A table or figure of the paper with our numbers beside it, by the names that `values` has."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.paper.values import PaperFigure, PaperTable


@dataclass(frozen=True, slots=True)
class Measured:
    """Our numbers in one set-up, by the paper's names; those that it does not measure are left out."""

    values: Mapping[str, float]
    trials: int
    setup: str
    """A clause that says what differs between protocol and default, such as "tolerance 20 us"."""


@dataclass(frozen=True, slots=True)
class Reproduction:
    """A table or figure of the paper with our numbers: as the paper measured, and as the program comes.

    Raises ValueError for a name that the table does not have, and for a figure without a drawing.
    """

    of: PaperTable
    protocol: Measured
    default: Measured | None
    """What the program does where no option is given (`DEFAULT_TOLERANCE_NS`, no delay of a trigger); None
    where there is nothing to choose, so that the protocol's numbers are the default's, too."""
    simulated: str
    """Which parts are simulated, in a sentence."""
    given: tuple[str, ...] = ()
    """Names of numbers that went into the model, so that they agree by construction."""
    notes: tuple[str, ...] = ()
    """Sentences, such as what differs from the paper and why."""
    draw: Callable[[Path], Path] | None = None
    """Draws a figure into the file that it is given, and returns that."""
    suffix: str = ".png"
    """What kind of picture it is drawn as."""

    def __post_init__(self) -> None:
        """Check the names."""
        measured = [self.protocol.values, {} if self.default is None else self.default.values, self.given]
        unknown = {name for names in measured for name in names} - set(self.of.names)
        if unknown:
            raise ValueError(f"{self.of.key} has no {', '.join(sorted(unknown))}")
        if isinstance(self.of, PaperFigure) and self.draw is None:
            raise ValueError(f"{self.of.key} is a figure and needs a drawing")
