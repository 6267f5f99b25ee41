"""A method is one folder: without it and its entry point, all else runs and says nothing of it."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from capture_app.session.reading.reader import Session
from tests.unit.packaging.cut_tree import CutTree
from tests.unit.reconstruction.methods.test_deletion import (
    NAMES,
    run,
    tree,  # noqa: F401 - a fixture
)

WITHOUT_STUDY = {"batch", "trajectory", "view"}
STUDIES = [name for name in NAMES if name not in WITHOUT_STUDY]
GONE = [*((name,) for name in NAMES), NAMES]
"""Each method, and all."""
COMPARED = [*((name,) for name in STUDIES), sorted(WITHOUT_STUDY), NAMES]
"""Each method of a comparison, those that are in none, and all."""
OWN_COMMANDS = {"batch", "multiview", "panorama", "stereo"}
PAIRED = {"panorama", "stereo"}
HELP = """
import reconstruction
from reconstruction.cli import run
from reconstruction.reconstructed_session import ReconstructedSession
assert run(["--help"]) == run(["compare", "--help"]) == 0
print("public:", *dir(reconstruction), *dir(ReconstructedSession.__new__(ReconstructedSession)))
"""


@pytest.mark.parametrize("gone", GONE, ids=lambda gone: gone[0] if len(gone) == 1 else "all")
def test_the_help_of_the_others_works_and_does_not_name_it(tree: CutTree, gone: Sequence[str]) -> None:
    done = run(tree, gone, "-c", HELP)
    assert (done.returncode, done.stderr) == (0, "")
    shown, _, public = done.stdout.partition("public:")
    listed = shown.partition("Commands:")[2].partition("\n\n")[0]
    commands = set(re.findall(r"^  (\w+)  ", listed, re.MULTILINE))
    assert commands & OWN_COMMANDS == OWN_COMMANDS - {*gone}
    assert {"compare", "calibrate"} <= commands
    choices = re.search(r"--study \[([a-z_|]*)\]", shown)[1]
    assert choices == "|".join(name for name in STUDIES if name not in gone)
    for name in OWN_COMMANDS - {"batch"}:
        assert (f"--{name}-pair" in shown) == (name in PAIRED and name not in gone)
        assert (name.capitalize() in public.split()) == (name in public.split()) == (name not in gone)


@pytest.mark.parametrize("gone", COMPARED, ids=lambda gone: "all" if gone == NAMES else "-".join(gone))
def test_a_comparison_works_with_the_methods_that_are_left(
    tree: CutTree, gone: Sequence[str], boards: Session, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    options = ["--max-instants", 1, *(() if "multiview" in gone else ("--max-multiview-instants", 1))]
    done = run(tree, gone, "-m", "reconstruction.cli", "compare", boards.folder, *options, "--out", out)
    assert done.returncode == 0, done.stderr
    result = json.loads((out / "metrics.json").read_text())
    assert {one["name"] for one in result["studies"]} == {*STUDIES} - {*gone}
    assert (out / "report.html").is_file()


def test_what_needs_a_method_that_is_gone_names_it(tree: CutTree, boards: Session, tmp_path: Path) -> None:
    done = run(
        tree, ["multiview"], "-m", "reconstruction.cli", "batch", boards.folder, "--out", tmp_path / "b"
    )
    assert "'multiview' is not in simulshot.methods" in done.stderr
    done = run(tree, ["stereo"], "-m", "reconstruction.cli", "tolerance", boards.folder)
    assert "no study of a pair's depth is installed" in done.stderr
    code = f"from reconstruction import open_session; open_session({str(boards.folder)!r}).stereo()"
    assert "has no attribute 'stereo'" in run(tree, ["stereo"], "-c", code).stderr
