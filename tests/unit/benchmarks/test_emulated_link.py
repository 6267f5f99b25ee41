"""What the benchmarks' emulated link says where it cannot be had; `make bench NAME=sync` measures it."""

import importlib
from pathlib import Path

import pytest

from benchmarks.emulated_link.delays import Delays
from benchmarks.emulated_link.network import what_is_missing
from tests.project import ROOT


def make_tools(folder: Path, *names: str) -> str:
    for name in names:
        (folder / name).write_text("#!/bin/sh\n")
        (folder / name).chmod(0o755)
    return str(folder)


@pytest.mark.parametrize(
    ("tools", "is_root", "said"),
    [
        ((), True, "apt-get install iproute2"),
        (("ip",), True, "apt-get install gcc"),
        (("ip", "cc"), False, "sudo make"),
        (("ip", "cc"), True, ""),
    ],
)
def test_it_says_what_is_missing_and_what_to_type(
    tmp_path: Path, tools: tuple[str, ...], is_root: bool, said: str
) -> None:
    told = what_is_missing(is_root=is_root, search_path=make_tools(tmp_path, *tools))
    assert said in told
    assert bool(told) == bool(said)
    assert "\n" not in told


def test_each_law_has_its_word() -> None:
    assert str(Delays(5.0, 9.0)) == "gamma,5.0,9.0,2.0"
    assert str(Delays(5.0, 9.0, "lognormal", 0.6)) == "lognormal,5.0,9.0,0.6"
    assert str(Delays(5.0, 9.0, "rare", wait_us=1.0, quick_us=0.5)) == "rare,5.0,9.0,2.0,1.0,0.5"
    assert str(Delays(5.0, 5.0, "constant")) == "constant,5.0"


def test_every_benchmark_finds_what_it_imports() -> None:
    root = ROOT
    files = sorted(path.relative_to(root) for path in (root / "benchmarks").rglob("*.py"))
    for path in files:
        importlib.import_module(".".join(path.with_suffix("").parts))
