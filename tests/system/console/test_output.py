"""A process whose output nobody reads goes on, and says what it left out when somebody reads again."""

import signal
from pathlib import Path

import pytest

from tests.unit.console.test_output import TIMEOUT_S, started, until_there


@pytest.mark.parametrize("options", [["-v"], []], ids=["with what is logged", "as usual"])
def test_a_process_whose_output_nobody_reads_goes_on_and_ends_by_a_signal(
    tmp_path: Path, options: list[str]
) -> None:
    process = started(tmp_path, "20000", *options)
    until_there(tmp_path / "done")
    process.send_signal(signal.SIGTERM)
    assert process.wait(TIMEOUT_S) == 130
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    process.stderr.close()
