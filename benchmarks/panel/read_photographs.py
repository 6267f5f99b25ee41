"""Reads the time off photographs of panels drawn at random, and counts how often it is right and knows it.

Rendered photographs: `python -m benchmarks.panel.read_photographs [--count 200] [--first 0]`.
"""

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.panel.photographs import Case, draw_case
from capture_app.companions.panel.finder import PanelNotFoundError
from capture_app.companions.panel.pattern import nearest_ns
from capture_app.companions.panel.time_reading import read_panel

LED_LIMIT_NS = 100_000.0
SCREEN_LIMIT_TICKS = 0.25


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a photograph: its error and error bar in ns, or why it was refused."""

    case: Case
    error_ns: float = 0.0
    uncertainty_ns: float = 0.0
    refusal: str = ""

    @property
    def limit_ns(self) -> float:
        """Maximum error of a correct time."""
        panel = self.case.photograph.panel
        return SCREEN_LIMIT_TICKS * panel.tick_ns if panel.is_screen else LED_LIMIT_NS

    @property
    def in_bar(self) -> bool:
        """Whether the truth is within the error bar."""
        return abs(self.error_ns) <= self.uncertainty_ns


def judge(case: Case) -> Outcome:
    """Read a photograph and compare it with the truth."""
    photograph = case.photograph
    picture = case.picture()
    try:
        read = read_panel(
            picture,
            exposure_ns=photograph.exposure_ns if case.told_exposure else None,
            row_time_ns=photograph.row_time_ns if case.told_row_time else None,
        )
    except PanelNotFoundError as error:
        return Outcome(case, refusal=str(error))
    error_ns = nearest_ns(read.middle_ns - case.shown_ns(read.row), photograph.panel.cycle_ns)
    return Outcome(case, error_ns, read.uncertainty_ns)


def table(outcomes: Sequence[Outcome]) -> str:
    """Return counts by exposure: read, refused, within the limit, and within the error bar."""
    lines = ["exposure          read  refused  in limit  in bar  largest/limit  median bar/limit"]
    edges = (0.0, 0.3e6, 1e6, 3e6, 8e6, 21e6)
    bands = [(f"{a / 1e6:4.1f} to {b / 1e6:4.1f} ms", a, b) for a, b in itertools.pairwise(edges)]
    for name, low, high in (*bands, ("all", 0.0, 1e12)):
        some = [o for o in outcomes if low <= o.case.photograph.exposure_ns < high]
        read = [o for o in some if not o.refusal]
        if not read:
            continue
        right = np.mean([abs(o.error_ns) <= o.limit_ns for o in read])
        largest = max(abs(o.error_ns) / o.limit_ns for o in read)
        bar = np.median([o.uncertainty_ns / o.limit_ns for o in read])
        covered = np.mean([o.in_bar for o in read])
        lines.append(
            f"{name:17s} {len(read):4d} {len(some) - len(read):8d} {100 * right:7.1f} % "
            f"{100 * covered:5.1f} % {largest:12.2f} {bar:16.2f}"
        )
    return "\n".join(lines)


def main() -> None:
    """Run it and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    for kind in ("led", "screen"):
        seeds = range(options.first, options.first + options.count)
        outcomes = [judge(draw_case(seed, screen=kind == "screen")) for seed in seeds]
        print(f"{kind}: {options.count} rendered photographs, seeds from {options.first}")
        print(table(outcomes))


if __name__ == "__main__":
    main()
