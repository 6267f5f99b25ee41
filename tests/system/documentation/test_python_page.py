"""The examples of "In Python" and of the README print what the pages say they print."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.project import ROOT, SAMPLES
from tests.unit.documentation.test_python_page import (
    EXAMPLES,
    project,  # noqa: F401 - a fixture
)


@pytest.mark.usefixtures("project")
def test_all_examples_print_what_the_page_says() -> None:
    names: dict[str, object] = {}
    for example in EXAMPLES:
        assert example.run(names) == example.said


@pytest.mark.parametrize("name", ["error-bars", "late-depth"])
def test_notebooks_print_and_draw_what_they_hold(name: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    kept = ROOT / "docs" / "notebooks" / f"{name}.ipynb"
    again = tmp_path / "docs" / "notebooks" / kept.name
    again.parent.mkdir(parents=True)
    shutil.copyfile(kept, again)
    (tmp_path / "sample_sessions").symlink_to(SAMPLES)
    subprocess.run(
        [sys.executable, ROOT / "docs" / "notebooks" / "run.py", again],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=True,
    )
    before, after = (outputs(path) for path in (kept, again))
    assert after == before
    assert "image/png" in before


def outputs(notebook: Path) -> list[str]:
    """What the cells have printed, and that they have drawn."""
    cells = json.loads(notebook.read_text())["cells"]
    given = [output for cell in cells for output in cell.get("outputs", ())]
    return ["".join(one["text"]) if "text" in one else "".join(one["data"]) for one in given]
