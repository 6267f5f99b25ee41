"""How an experiment hands over its part of the paper: `capture-app experiment paper` assembles them.

A room that measures something of the paper has a module `paper.py` with `paper_part` (see `PaperPart`), which
returns a `Reproduction` for each table and figure that is the room's own:

    def paper_part(*, share: float, seed: int, talk: Callable[[str], None]) -> Sequence[Reproduction]:
        trials = share_of(TRIALS, share)
        ...
        return [
            Reproduction(
                of=TABLE_2,
                seed=seed,
                protocol=Measured({"total.mean": 18.2, "total.max": 61.0, ...}, trials, "20 us, ..."),
                default=Measured({"total.mean": 12.9, ...}, trials, "15 us, ..."),
                simulated="Clocks, link, sensors and panel.",
            ),
            Reproduction(of=FIGURE_6, ..., draw=lambda folder: [save(figure, folder / "figure-6.png")]),
        ]

`paper_values.py` has the tables and figures, and the names of their numbers. Which rooms have a part stands
in `capture_app/experiments/paper/parts.py`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from capture_app.experiments.common.paper_values import PaperFigure, PaperTable
from capture_app.experiments.common.result import Kind


@dataclass(frozen=True, slots=True)
class Measured:
    """Our numbers in one set-up, by the paper's names; those that it does not measure are left out."""

    values: Mapping[str, float]
    trials: int
    setup: str
    """A clause that says what differs between protocol and default, such as "tolerance 20 us"."""
    kind: Kind = "simulated"


@dataclass(frozen=True, slots=True)
class Reproduction:
    """A table or figure of the paper with our numbers: as the paper measured, and as the program comes.

    Raises ValueError for a name that the table does not have, and for a figure without a drawing.
    """

    of: PaperTable
    seed: int
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
    draw: Callable[[Path], list[Path]] | None = None
    """Draws into a folder that exists and returns the files, named after the figure's key."""

    def __post_init__(self) -> None:
        """Check the names."""
        measured = [self.protocol.values, {} if self.default is None else self.default.values, self.given]
        unknown = {name for names in measured for name in names} - set(self.of.names)
        if unknown:
            raise ValueError(f"{self.of.key} has no {', '.join(sorted(unknown))}")
        if isinstance(self.of, PaperFigure) and self.draw is None:
            raise ValueError(f"{self.of.key} is a figure and needs a drawing")


class PaperPart(Protocol):
    """What the module `paper` of a room offers."""

    def paper_part(self, *, share: float, seed: int, talk: Callable[[str], None]) -> Sequence[Reproduction]:
        """Measure; `share` is the part of the full number of trials (the paper's), 1.0 for all of them."""


def share_of(trials: int, share: float, *, least: int = 2) -> int:
    """How many trials that share of them is, and at least so many."""
    return max(min(least, trials), round(share * trials))
