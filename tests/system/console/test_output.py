"""A process whose output nobody reads goes on, and says what it left out when somebody reads again."""

import signal
import subprocess
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
    close(process)


def test_a_process_whose_terminal_closes_ends_in_order_and_with_nohup_goes_on(tmp_path: Path) -> None:
    process = started(tmp_path, "101")
    until_there(tmp_path / "done")
    process.send_signal(signal.SIGHUP)
    assert process.wait(TIMEOUT_S) == 130
    close(process)

    (tmp_path / "done").unlink()
    process = started(tmp_path, "101", by=("nohup",))
    until_there(tmp_path / "done")
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.5)
    process.kill()
    process.wait(TIMEOUT_S)
    close(process)


def close(process: subprocess.Popen[bytes]) -> None:
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    process.stderr.close()
