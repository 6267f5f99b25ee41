"""Result of a measurement: summarized errors, tables to print, pictures to draw."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from capture_app.common.optional_packages import load_optional
from capture_app.console.terminal import table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Figures = Mapping[str, Any]
"""Numbers by name, the unit last in the name (`_us`, `_s`, `_ppm`; none for counts); may be nested."""

Kind = Literal["simulated", "emulated link", "real"]


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of a measurement: ours, the baselines' in the same run, and the paper's."""

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
    """A result with its tables and notes."""

    result: Result
    tables: tuple[Table, ...]
    notes: tuple[str, ...]


def outcome_lines(outcome: Outcome) -> Iterator[str]:
    """Return the tables and notes of a measurement as lines."""
    result = outcome.result
    yield f"{result.name}: {result.kind}, {result.trials} trials, seed {result.seed}"
    for one in outcome.tables:
        yield f"\n{one.title}" if one.title else ""
        yield table(one.head, one.rows)
    for note in outcome.notes:
        yield f"\n{note}"


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


def new_figure(**options: Any) -> "Figure":
    """Return an empty figure; options as for `matplotlib.figure.Figure`. Raises NotAvailableError."""
    load_optional("matplotlib", "plots", "drawing figures")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained", **options)
    FigureCanvasAgg(figure)
    return figure


def save(figure: "Figure", path: Path) -> Path:
    """Write the figure in the suffix's format (.png, .jpg or .svg); equal figures give equal bytes."""
    from matplotlib import rc_context

    nameless = {".png": {"Software": None}, ".svg": {"Date": None}}
    with rc_context({"svg.hashsalt": path.stem}):
        figure.savefig(path, dpi=120, metadata=nameless.get(path.suffix))
    return path
