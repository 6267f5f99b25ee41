"""A study of another package, as docs/plugins.md shows it, in the ordinary command."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.project import ROOT
from tests.unit.documentation.pages import plugin_module


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of the recipe, and one whose study does not load."""
    folder = tmp_path_factory.mktemp("installed")
    for heading, group in (("A check", "simulshot.checks"), ("A method", "simulshot.methods")):
        recipe = (ROOT / "docs" / "plugins.md").read_text().partition(f"\n## {heading}\n")[2]
        module, metadata = plugin_module(recipe), re.search(r"```toml\n(.*?)```", recipe, re.DOTALL)[1]
        ((name, target),) = tomllib.loads(metadata)["project"]["entry-points"][group].items()
        (folder / f"{target.partition(':')[0]}.py").write_text(module)
        install(folder, name, target, group)
    score = "simulshot_average_score.py"
    (folder / score).write_text((ROOT / "docs" / "examples" / "plugins" / score).read_text())
    install(folder, "broken", "no_such_module:Check", "simulshot.checks")
    return folder


def install(folder: Path, name: str, target: str, group: str) -> None:
    info = folder / f"simulshot_{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: simulshot-{name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {target}\n")


def reconstruct(package: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "reconstruction.cli", *map(str, arguments)]
    return subprocess.run(command, env=environment(package), capture_output=True, text=True, check=True)


def environment(package: Path) -> dict[str, str]:
    path = os.pathsep.join((str(package), str(ROOT), *sys.path))
    return {**os.environ, "PYTHONPATH": path, "COLUMNS": "100"}


def test_help_lists_the_study_and_its_option(package: Path) -> None:
    shown = reconstruct(package, "compare", "--help")
    assert "|flicker|" in shown.stdout
    assert "[average|" in shown.stdout
    assert re.search(
        r"--flicker-instants N\s+Compare the light at this many instants\.\s+\[default: 8\]", shown.stdout
    )
    (line,) = shown.stderr.splitlines()
    assert line.startswith("the plugin 'broken' of simulshot.checks does not load: No module named")
