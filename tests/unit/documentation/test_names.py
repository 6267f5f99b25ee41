"""Names are the field's: a name with a word of this list is new, unless it stands below."""

import ast
import re
from pathlib import Path

import pytest

from tests.project import ROOT

WORDS = """
alike away coarse doubt farthest fewest fullest gone hasty kept knock lateness least meeting misfit mishap
most mover movers news pace patience reach remark share sides spread strange stranger strangers tell telling
theirs told turn usual vitals wanted way ways wish wished
"""
"""The field says min, max, stored, residual, event, error, interval, fraction, timeout, report, path, ..."""
STANDING = """
ALIKE ALIKE_INSTANTS REACH REACH_PX _over_share _share_bytes _tell alike describe_spread doubt farthest
find_alike gone inlier_share kept kept_at least misfit misfit_px most_together mover_coverage
mover_f_score_1cm mover_misfit mover_pixels mover_within_2pct movers movers_1cm moving_share reach reach_ms
row_spread_ns share share_bytes sides spread spread_error_ns spread_ns tell theirs theirs_ms turn turn_deg
turn_error under_way usual
"""
"""Names in files, messages, options and plugins, and what is left."""
NAMELESS = {"one", "found", "of"}
"""Names that do not say what the value is."""
MAX_NAMELESS = {
    "capture_app/companions": 25,
    "capture_app/node": 10,
    "capture_app/plugins": 10,
    "capture_app/session": 16,
    "capture_app/tui": 36,
    "reconstruction/checks": 5,
    "reconstruction/methods": 45,
    "reconstruction/report": 5,
    "reconstruction/scene": 8,
    "reconstruction/time_offsets": 8,
}
"""How many of them the files of a room bind at most; 3 in other rooms, 222 in all."""
ROOMS = [
    str(path.parent.relative_to(ROOT))
    for top in ("capture_app", "reconstruction")
    for path in sorted((ROOT / top).glob("*/__init__.py"))
]


def bound(path: Path) -> set[str]:
    """Return the names of a module, and of what it defines or assigns."""
    names = {path.stem}
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.id if isinstance(node, ast.Name) else node.attr)
    return names


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_has_the_fields_names(room: str) -> None:
    names = [bound(path) for path in (ROOT / room).rglob("*.py")]
    parts = {
        name: {part.lower() for part in re.findall("[A-Z]?[a-z]+|[A-Z]+", name)}
        for name in set().union(*names)
    }
    assert {name for name in parts if parts[name] & set(WORDS.split())} <= set(STANDING.split())
    assert sum(len(NAMELESS & of_file) for of_file in names) <= MAX_NAMELESS.get(room, 3)
