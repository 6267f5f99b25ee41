"""Which rooms measure something of the paper, and all of it in the paper's order."""

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import cast

from capture_app.experiments.common.paper_values import FIGURES, TABLES, PaperTable
from capture_app.experiments.common.reproduction import PaperPart, Reproduction

PARTS = {
    "naive": ("table-1",),
    "led_panel": ("table-2", "figure-5", "figure-6"),
    "clock_filters": ("table-3", "least-round-trip", "figure-7", "figure-s1", "figure-s2"),
    "phase": ("injections", "restarts"),
}
"""Rooms of the experiments with a module `paper`, and what each measures, by key."""


def measure_all(
    *, share: float, seed: int, talk: Callable[[str], None], only: frozenset[str] = frozenset()
) -> dict[str, Reproduction]:
    """Return all tables and figures by key, measured by their rooms; `only` names keys, empty for all.

    Raises ValueError where a room gives another table than it says.
    """
    found: dict[str, Reproduction] = {}
    for room, keys in PARTS.items():
        name = f"capture_app.experiments.{room}.paper"
        if (only and not only & set(keys)) or find_spec(name) is None:
            continue
        talk(f"{', '.join(keys)} ...")
        part = cast(PaperPart, import_module(name)).paper_part(share=share, seed=seed, talk=talk)
        if {one.of.key for one in part} != set(keys):
            raise ValueError(f"{name} gives {', '.join(one.of.key for one in part)}")
        found |= {one.of.key: one for one in part}
    return {one.key: found[one.key] for one in all_of_the_paper() if one.key in found}


def all_of_the_paper() -> tuple[PaperTable, ...]:
    """All tables, then all figures."""
    return (*TABLES, *FIGURES)
