"""Benchmarks by name: each is there, and `make help` has a line for it."""

import importlib.util
import re
import subprocess
import sys

import pytest

from benchmarks.__main__ import BENCHES
from tests.project import ROOT


@pytest.mark.parametrize("name", BENCHES)
def test_the_module_of_each_name_is_there(name: str) -> None:
    bench = BENCHES[name]
    assert {*bench} <= {"module", "does", "always", "otherwise", "needs"}
    assert importlib.util.find_spec(bench["module"]) is not None
    assert bench["does"][0].islower()


def test_a_name_runs_its_module_and_another_is_refused() -> None:
    def run(*words: str) -> "subprocess.CompletedProcess[str]":
        command = [sys.executable, "-m", "benchmarks", *words]
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)

    assert [line.split()[2] for line in run().stdout.splitlines()] == [f"NAME={name}" for name in BENCHES]
    assert "usage: delete_parts.py" in run("deletions", "--help").stdout
    refused = run("nothing")
    assert (refused.returncode, refused.stderr) == (1, "there is no NAME=nothing: see make help\n")


def test_the_makefile_leaves_the_names_to_the_table() -> None:
    (rule,) = re.findall(r"^bench: .*\n(?:\t.*\n)+", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert [name for name in BENCHES if re.search(rf"\b{name}\b", rule)] == []
