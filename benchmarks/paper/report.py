"""Contents of `paper.json`: every table and figure of the paper beside ours, measured and drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Literal

import msgspec

from benchmarks.paper.applications import Application
from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.result import Kind
from benchmarks.paper.values import FIGURES, TABLE_1, TABLE_2, TABLES, PaperTable, PaperValue
from capture_app.console.terminal import talk

Verdict = Literal["better", "worse", "put in", ""]
"""Verdict on our value at the paper's protocol, if less is better; "put in" means a model input."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """A number: the paper's, ours at its protocol, ours by default; None if unknown."""

    name: str
    label: str
    unit: str
    paper: float | None
    paper_at_most: bool
    protocol: float | None
    default: float | None
    verdict: Verdict
    headline: bool


class SetUp(msgspec.Struct, frozen=True, kw_only=True):
    """How our values were measured."""

    setup: str
    trials: int
    kind: Kind


class Entry(msgspec.Struct, frozen=True, kw_only=True):
    """A table or a figure; `files` are its pictures, beside `paper.json`."""

    key: str
    title: str
    place: str
    seed: int
    simulated: str
    protocol: SetUp
    default: SetUp
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    files: tuple[str, ...]


class PaperReport(msgspec.Struct, frozen=True, kw_only=True):
    """All tables and figures, in the paper's order."""

    quick: bool
    seed: int
    tables: tuple[Entry, ...]
    figures: tuple[Entry, ...]
    applications: tuple[Application, ...]
    """Results of other commands for bundled sessions; without numbers if these were not given."""

    def pictures(self) -> tuple[str, ...]:
        """Return the names of all pictures."""
        entries = (*self.tables, *self.figures)
        return tuple(
            name
            for files in (*(e.files for e in entries), *(a.files for a in self.applications))
            for name in files
        )


def make_report(
    found: Mapping[str, Reproduction],
    applications: tuple[Application, ...],
    folder: Path,
    *,
    quick: bool,
    seed: int,
) -> PaperReport:
    """Draw all pictures into an existing folder, and assemble the report."""
    tables: list[Entry] = []
    figures: list[Entry] = []
    for one in found.values():
        if one.draw is None:
            tables.append(_entry(one, seed, ()))
        else:
            path = one.draw(folder / f"{one.of.key}{one.suffix}")
            talk(f"drew {path}")
            figures.append(_entry(one, seed, (path.name,)))
    return PaperReport(
        quick=quick, seed=seed, tables=tuple(tables), figures=tuple(figures), applications=applications
    )


def _entry(one: Reproduction, seed: int, files: tuple[str, ...]) -> Entry:
    default = one.default or one.protocol
    rows = tuple(
        _row(value, one.protocol, default, put_in=value.name in one.given) for value in one.of.values
    )
    return Entry(
        key=one.of.key,
        title=one.of.title,
        place=one.of.place,
        seed=seed,
        simulated=one.simulated,
        protocol=_set_up(one.protocol),
        default=_set_up(default),
        rows=rows,
        notes=one.notes,
        files=files,
    )


def _set_up(measured: Measured) -> SetUp:
    return SetUp(setup=measured.setup, trials=measured.trials, kind="simulated")


def _row(value: PaperValue, protocol: Measured, default: Measured, *, put_in: bool) -> Row:
    ours = protocol.values.get(value.name)
    verdict: Verdict = "put in" if put_in else ""
    if not put_in and value.less_is_better and value.value is not None and ours is not None:
        verdict = "better" if ours <= value.value else "worse"
    return Row(
        name=value.name,
        label=value.label,
        unit=value.unit,
        paper=value.value,
        paper_at_most=value.at_most,
        protocol=ours,
        default=default.values.get(value.name),
        verdict=verdict,
        headline=value.headline,
    )


PARTS = {
    "clock_paper": ("table-3", "least-round-trip", "figure-s2"),
    "phase_paper": ("injections", "restarts"),
    "led_panel": ("table-2", "figure-5"),
    "five_phones": ("worst-pair", "start-up", "burst"),
    "naive": ("table-1",),
}
"""What each module measures, by key.

Each has `paper_part(share, seed)`, which returns a `Reproduction` per key, with that fraction of the paper's
number of trials.
"""


def measure_all(*, share: float, seed: int, only: frozenset[str] = frozenset()) -> dict[str, Reproduction]:
    """Return all tables and figures by key, as their modules measure them; `only` names keys, empty for all.

    Raises ValueError if a module returns another table than declared.
    """
    found: dict[str, Reproduction] = {}
    for module, keys in PARTS.items():
        name = f"{__package__}.{module}"
        if only and not only & set(keys):
            continue
        talk(f"{', '.join(keys)} ...")
        part: Sequence[Reproduction] = import_module(name).paper_part(share=share, seed=seed)
        if {one.of.key for one in part} != set(keys):
            raise ValueError(f"{name} gives {', '.join(one.of.key for one in part)}")
        found |= {one.of.key: one for one in part}
    if TABLE_1.key in found and TABLE_2.key in found:
        found[TABLE_1.key] = _with_our_method(found[TABLE_1.key], found[TABLE_2.key])
    wanted = set(found) & only if only else set(found)
    return {one.key: found[one.key] for one in all_of_the_paper() if one.key in wanted}


def _with_our_method(table_1: Reproduction, table_2: Reproduction) -> Reproduction:
    """Return Table I with its last row, the total error of Table II, in ms."""
    totals = [
        {f"ours.{name}": one.values[f"total.{name}"] / 1000 for name in ("mean", "max", "std")}
        for one in (table_2.protocol, table_2.default or table_2.protocol)
    ]
    return replace(
        table_1,
        protocol=replace(table_1.protocol, values={**table_1.protocol.values, **totals[0]}),
        default=replace(table_1.protocol, values={**table_1.protocol.values, **totals[1]}),
    )


def all_of_the_paper() -> tuple[PaperTable, ...]:
    """Return all tables, then all figures."""
    return (*TABLES, *FIGURES)
