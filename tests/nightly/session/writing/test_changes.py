"""Pulled plugs: a change that is killed at any moment leaves one whole session, and can be done again."""

from pathlib import Path

import pytest

from tests.system.session.writing.test_changes import LEFT, check


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("change", list(LEFT))
def test_a_change_killed_at_every_step_leaves_a_whole_session(tmp_path: Path, change: str) -> None:
    check(tmp_path, change, 1, 10)
