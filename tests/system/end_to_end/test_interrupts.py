"""Ctrl-C, once: every process of a long command ends, without a traceback and without what is half done."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from capture_app.common.errors import ExitCode
from tests.project import JUMPER, ROOT
from tests.system.end_to_end.processes import children_of, is_running

from .conftest import TIMEOUT_S

BEGUN = re.compile(r"injections|depth of cam00")
SESSION = str(JUMPER)


@pytest.mark.parametrize(
    "command",
    [
        "benchmarks.paper phase",
        f"reconstruction.cli multiview {SESSION} --out out",
        # tests/system/reconstruction/methods/batch/test_kill.py interrupts one of cheap units.
        f"reconstruction.cli batch {SESSION} --jobs 2 --out out",
    ],
)
def test_one_interrupt_ends_it(command: str, tmp_path: Path) -> None:
    module, *arguments = command.split()
    said = tmp_path / "said"
    with said.open("w") as stderr:
        process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdout=stderr, stderr=stderr, start_new_session=True, cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
    try:
        until = time.monotonic() + TIMEOUT_S
        workers: list[int] = []
        while time.monotonic() < until and process.poll() is None:
            workers = [pid for pid in children_of(process.pid) if is_running(pid)]
            if len(workers) > 2 or BEGUN.search(said.read_text()):
                break
            time.sleep(0.05)
        assert process.poll() is None, said.read_text()
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(TIMEOUT_S) == ExitCode.INTERRUPTED
        assert "Traceback" not in said.read_text()
        while any(is_running(pid) for pid in workers):
            assert time.monotonic() < until, "a worker is left behind"
            time.sleep(0.05)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    # A batch keeps what it has; nothing else is there.
    left = {path.name for path in tmp_path.iterdir() if not path.name.startswith(".")}
    assert left <= {"said", "out"}
