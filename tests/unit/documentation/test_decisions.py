"""Every number that carries a verdict stands in docs/decisions, with the value that the code has."""

import ast
import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks.__main__ import BENCHES
from tests.project import ROOT

ROW = re.compile(r"^\| `(\w+)\.(\w+)` \| `(.+?)` \| (.+) \|$", re.MULTILINE)
PAGES = sorted((ROOT / "docs" / "decisions").glob("[0-9]*.md"))
DECIDED = (
    "clock_changes",
    "clock_filter",
    "consistency",
    "crossings",
    "gap_watch",
    "instant_votes",
    "likely_line",
    "phrases",
    "time_map",
    "timing",
    "verdict",
)
"""Modules of which every number carries a verdict."""
TECHNICAL = {"likely_line.LONG_AGO_NS", "verdict.PX_PER_S", "verdict._LIMITS_PX"}
"""Numbers without which the same is computed, or that define the grades (docs/session-format.md)."""


def module_file(stem: str) -> Path:
    (path,) = [path for top in ("capture_app", "reconstruction") for path in (ROOT / top).rglob(f"{stem}.py")]
    return path


def module(stem: str) -> ModuleType:
    return importlib.import_module(".".join(module_file(stem).relative_to(ROOT).with_suffix("").parts))


def numbers(stem: str) -> set[str]:
    """Return the names of a module's constants whose values are written as numbers."""
    found = set[str]()
    for node in ast.parse(module_file(stem).read_text()).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        parts = list(ast.walk(node.value))
        is_number = any(
            isinstance(part, ast.Constant) and isinstance(part.value, int | float) for part in parts
        )
        if not is_number or any(
            isinstance(part, ast.Name | ast.Call | ast.Dict | ast.comprehension) for part in parts
        ):
            continue
        for target in [node.target] if isinstance(node, ast.AnnAssign) else node.targets:
            found |= {f"{stem}.{part.id}" for part in ast.walk(target) if isinstance(part, ast.Name)}
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_decision_has_the_values_of_the_code(page: Path) -> None:
    text = page.read_text()
    assert all(f"**{part}**: " in text for part in ("Status", "Context", "Measured by", "To change it"))
    rows = ROW.findall(text)
    assert rows
    stated = {f"{stem}.{name}": eval(value, {"__builtins__": {}}) for stem, name, value, _ in rows}
    assert stated == {f"{stem}.{name}": getattr(module(stem), name) for stem, name, _, _ in rows}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_command_that_measured_it_still_exists(page: Path) -> None:
    (command,) = re.findall(r"\*\*Measured by\*\*: (.+?)(?=\*\*To change it)", page.read_text(), re.DOTALL)
    named = re.findall(r"`([^`]+)`", command)
    assert named
    for words in named:
        for path in re.findall(r"(?:tests|benchmarks)/\S+", words):
            assert (ROOT / path.split("::")[0]).exists(), path
        for name in re.findall(r"NAME=(\S+)", words):
            assert name in BENCHES


@pytest.mark.parametrize("stem", DECIDED)
def test_each_number_of_a_module_is_decided(stem: str) -> None:
    decided = {f"{of}.{name}" for page in PAGES for of, name, _, _ in ROW.findall(page.read_text())}
    assert numbers(stem) - decided - TECHNICAL == set()


def test_the_index_lists_all() -> None:
    index = (ROOT / "docs" / "decisions" / "README.md").read_text()
    assert all(f"({page.name})" in index for page in PAGES)
