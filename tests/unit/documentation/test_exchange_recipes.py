"""The exporter and importer of docs/plugins.md, as written there, as a package outside the project."""

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from capture_app.common.errors import ExitCode
from tests.project import ROOT
from tests.unit.documentation.pages import plugin_module
from tests.unit.plugins.programs.conftest import Make, make  # noqa: F401 - a fixture

_RECIPE = re.compile(r"^## .*?(?=^## |\Z)", re.DOTALL | re.MULTILINE)
_BLOCK = re.compile(r"```(toml)\n(.*?)```", re.DOTALL)
_ENTRY = re.compile(r'\[project\.entry-points\."(.+)"\]\n(\S+) = "(\w+):(\w+)"')


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """The modules and metadata of an installed package, with a broken exporter and importer beside."""
    folder = tmp_path / "site"
    metadata = folder / "image_index-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: image-index\nVersion: 1.0\n")
    entries = []
    for recipe in _RECIPE.findall((ROOT / "docs" / "plugins.md").read_text()):
        blocks = dict(_BLOCK.findall(recipe))
        entry = _ENTRY.search(blocks.get("toml", ""))
        if entry is None or entry[1] not in ("simulshot.exporters", "simulshot.importers"):
            continue
        (folder / f"{entry[3]}.py").write_text(plugin_module(recipe))
        entries += [f"[{entry[1]}]", f"{entry[2]} = {entry[3]}:{entry[4]}", "broken = no_such_module:NOTHING"]
    assert len(entries) == 6
    (metadata / "entry_points.txt").write_text("\n".join(entries))
    return folder


@dataclass(frozen=True)
class Done:
    returncode: int
    stdout: str
    stderr: str


PROGRAM = """
import json, sys
from capture_app.cli import run
for line in json.loads(sys.argv[1]):
    code = run(["sessions", *line])
    print(code, end="\\0", flush=True)
    print(end="\\0", file=sys.stderr, flush=True)
"""


def run(package: Path, *lines: tuple[str, ...]) -> list[Done]:
    """What comes of command lines that one process runs one after the other."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, json.dumps(lines)],
        env={**os.environ, "PYTHONPATH": f"{package}:{ROOT}"},
        capture_output=True,
        text=True,
        check=True,
    )
    printed, said = (text.split("\0")[:-1] for text in (done.stdout, done.stderr))
    found = []
    for out, err in zip(printed, said, strict=True):
        *shown, code = re.split(r"(?<=\n)", out)
        found.append(Done(int(code), "".join(shown), err))
    return found


def test_help_lists_it_and_skips_what_is_broken(package: Path) -> None:
    for done in run(package, ("export", "--help"), ("import", "--help")):
        assert done.returncode == 0
        assert "images and index.json with their times" in done.stdout
        (warning,) = done.stderr.splitlines()
        assert "no_such_module" in warning
        assert "'broken' of simulshot." in warning


def test_an_option_of_another_format_is_named(make: Make, package: Path, tmp_path: Path) -> None:  # noqa: F811
    arguments = ("export", str(make().folder), "--to", "image-index", "--out", str(tmp_path / "out"))
    done, mistyped = run(package, (*arguments, "--points", "cloud.ply"), (*arguments, "--pionts=3"))
    assert done.returncode == ExitCode.BAD_INPUT
    assert "image-index takes no --points (it is for colmap, n3dv, nerfstudio, splats)" in done.stderr
    assert mistyped.returncode == ExitCode.USAGE
