"""Which modules measure something of the paper, and all of it in the paper's order."""

from collections.abc import Callable
from importlib import import_module
from typing import cast

from capture_app.experiments.common.paper_values import FIGURES, TABLES, PaperTable
from capture_app.experiments.common.reproduction import PaperPart, Reproduction

PARTS = {
    "clock_filters.paper": ("table-3", "least-round-trip", "figure-7", "figure-s1", "figure-s2"),
    "phase.paper": ("injections", "restarts"),
    "led_panel.paper": ("table-2", "figure-5", "figure-6"),
    "paper.five_phones": ("worst-pair", "start-up", "burst"),
    "naive.paper": ("table-1",),
    "paper.drawings": ("figure-3", "figure-4"),
}
"""Modules of the experiments with a `paper_part`, and what each measures, by key."""


def measure_all(
    *, share: float, seed: int, talk: Callable[[str], None], only: frozenset[str] = frozenset()
) -> dict[str, Reproduction]:
    """Return all tables and figures by key, as their modules measure them; `only` names keys, empty for all.

    Raises ValueError where a module gives another table than it says.
    """
    found: dict[str, Reproduction] = {}
    for module, keys in PARTS.items():
        name = f"capture_app.experiments.{module}"
        if only and not only & set(keys):
            continue
        talk(f"{', '.join(keys)} ...")
        part = cast(PaperPart, import_module(name)).paper_part(share=share, seed=seed, talk=talk)
        if {one.of.key for one in part} != set(keys):
            raise ValueError(f"{name} gives {', '.join(one.of.key for one in part)}")
        found |= {one.of.key: one for one in part}
    wanted = set(found) & only if only else set(found)
    return {one.key: found[one.key] for one in all_of_the_paper() if one.key in wanted}


def all_of_the_paper() -> tuple[PaperTable, ...]:
    """All tables, then all figures."""
    return (*TABLES, *FIGURES)
