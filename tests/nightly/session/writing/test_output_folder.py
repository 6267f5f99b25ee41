"""The one output folder: killed, refused, out of room or doubled, there is always one whole result."""

from pathlib import Path

import pytest

from tests.unit.session.writing.test_output_folder import killed


@pytest.mark.timeout(1800)
def test_killed_at_every_step_and_again_in_the_next_run(tmp_path: Path) -> None:
    assert len(killed(tmp_path, 1, 0)) > 150
    killed(tmp_path, 2, 2)
