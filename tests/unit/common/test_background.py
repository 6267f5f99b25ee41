"""What runs in the background has the priority that it was given, whatever that of its parent."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

AS_A_CHILD = (
    "import os, sys; os.setpriority(os.PRIO_PROCESS, 0, int(sys.argv[1]));"
    "os.execv(sys.executable, [sys.executable, *sys.argv[2:]])"
)


@pytest.mark.parametrize("parents", [5, 12])
def test_the_priority_does_not_add_to_the_parents(parents: int, tmp_path: Path) -> None:
    parents = max(parents, os.nice(0))
    background = ("-m", "capture_app.common.background", "10", "tests.unit.tui.jobs.quick_command")
    command = (sys.executable, "-c", AS_A_CHILD, str(parents), *background)
    run = subprocess.run(
        [*command, "priority", "--out", str(tmp_path / "out")], capture_output=True, text=True
    )
    assert run.stderr.strip() == f"priority {max(parents, 10)}"
