"""What every experiment returns: figures that sum up errors, a table to print, pictures to draw."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan, sqrt
from pathlib import Path
from typing import Any, Literal

import msgspec

Figures = Mapping[str, Any]
"""Numbers by name, the unit last in the name (`_us`, `_s`, `_ppm`; none for counts); nested at will."""

Kind = Literal["simulated", "emulated link", "real"]


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """The figures of an experiment: ours, those of the baselines in the same run, and the paper's."""

    name: str
    kind: Kind
    seed: int
    trials: int
    ours: Figures
    baseline: Figures
    paper: Figures


@dataclass(frozen=True, slots=True)
class Table:
    """A table to print; cells are text, the first column names the row."""

    head: tuple[str, ...]
    rows: list[tuple[str, ...]]
    title: str = ""


@dataclass(frozen=True, slots=True)
class Outcome:
    """A result with its faces: tables (all figures side by side if none is given), notes, pictures."""

    result: Result
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    draw: Callable[[Path], list[Path]] | None = None
    """Draws into a folder that exists and returns the files; see `plots.new_figure`."""

    def shown(self) -> tuple[Table, ...]:
        """The tables to print."""
        return self.tables or (side_by_side(self.result),)


def side_by_side(result: Result) -> Table:
    """Make a table with a row for each figure and the columns ours, baseline and paper."""
    columns = [dict(_flat(figures)) for figures in (result.ours, result.baseline, result.paper)]
    names = list(dict.fromkeys(name for column in columns for name in column))
    rows = [(name, *(_text(column.get(name)) for column in columns)) for name in names]
    return Table(("figure", "ours", "baseline", "paper"), rows)


def _flat(figures: Figures, before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in figures.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield before + name, value


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.1f}" if abs(value) >= 10.0 else f"{value:.3g}"
    return str(value)


def error_figures(errors: list[float]) -> dict[str, float]:
    """Return `mean_abs`, `max`, `std` and `bias` of errors, in their unit; raises ValueError for none."""
    if not errors:
        raise ValueError("no errors to sum up")
    bias = sum(errors) / len(errors)
    return {
        "mean_abs": sum(abs(e) for e in errors) / len(errors),
        "max": max(abs(e) for e in errors),
        "std": sqrt(sum((e - bias) ** 2 for e in errors) / len(errors)),
        "bias": bias,
    }


def quantile(ascending: Sequence[float], share: float) -> float:
    """The value below which that share lies; nan for none."""
    return ascending[min(len(ascending) - 1, int(share * len(ascending)))] if ascending else nan
