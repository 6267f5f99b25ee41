"""Pulled plugs: a change that is killed at any moment leaves one whole session, and can be done again."""

from pathlib import Path

import pytest

from tests.unit.session.writing.killed_writer import results_of

BEFORE, NOTED = ["killed", ""], ["killed", "the second jump"]
TRASHED = ".trash/killed/session"
LEFT = {
    "rename": ({"killed": BEFORE}, {"killed": ["renamed", ""]}, {"renamed": ["renamed", ""]}),
    "note": ({"killed": BEFORE}, {"killed": NOTED}),
    "trash": ({"killed": BEFORE}, {TRASHED: BEFORE}, {".trash/killed-2/session": BEFORE}),
    "restore": ({TRASHED: BEFORE}, {"killed": BEFORE}),
}
AFTER = {
    "rename": [["renamed", "renamed", ""]],
    "note": [["killed", *NOTED]],
    "trash": [[TRASHED, *BEFORE], [".trash/killed-2/session", *BEFORE]],
    "restore": [["killed", *BEFORE]],
}


def check(tmp_path: Path, change: str, every: int, least: int) -> None:
    runs = results_of("killed_changes", tmp_path, change, every)
    assert sum(run["ended"] == -9 for run in runs) >= least
    assert sum(run["ended"] == 0 for run in runs) == 2
    for run in runs:
        assert run["left"] in LEFT[change], run
        assert run["after"] in AFTER[change], run
        assert run["hidden"] == [], run


@pytest.mark.parametrize(("change", "every", "least"), [("rename", 31, 8), ("note", 47, 4), ("trash", 3, 4)])
def test_a_change_killed_at_some_steps_leaves_a_whole_session(
    tmp_path: Path, change: str, every: int, least: int
) -> None:
    check(tmp_path, change, every, least)
