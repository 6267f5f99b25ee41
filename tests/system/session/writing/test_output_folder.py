"""The one output folder: killed, refused, out of room or doubled, there is always one whole result."""

from pathlib import Path

from tests.unit.session.writing.test_output_folder import killed


def test_killed_at_some_steps_one_result_is_whole_and_leftovers_are_mentioned(tmp_path: Path) -> None:
    assert len(killed(tmp_path, 4, 0)) > 40
    assert any(one["next"] == -9 for one in killed(tmp_path, 29, 23))
