"""A study of another package, as docs/plugins.md shows it, in the ordinary command."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.reconstruction.found import study, values

ROOT = Path(__file__).resolve().parents[3]
SESSION = ROOT / "sample_sessions" / "jumper"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of the recipe, and one whose study does not load."""
    recipe = (ROOT / "docs" / "plugins.md").read_text().partition("\n## A study\n")[2]
    module, metadata = (
        re.search(rf"```{kind}\n(.*?)```", recipe, re.DOTALL)[1] for kind in ("python", "toml")
    )
    folder = tmp_path_factory.mktemp("installed")
    entries = tomllib.loads(metadata)["project"]["entry-points"]["simulshot.studies"]
    ((name, target),) = entries.items()
    (folder / f"{target.partition(':')[0]}.py").write_text(module)
    install(folder, name, target)
    install(folder, "broken", "no_such_module:Study")
    return folder


def install(folder: Path, name: str, target: str) -> None:
    info = folder / f"simulshot_{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: simulshot-{name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[simulshot.studies]\n{name} = {target}\n")


def reconstruct(package: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "reconstruction.cli", *map(str, arguments)]
    path = os.pathsep.join((str(package), str(ROOT)))
    environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "100"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True)


def test_help_lists_the_study_and_its_option(package: Path) -> None:
    shown = reconstruct(package, "compare", "--help")
    assert "|flicker|" in shown.stdout
    assert re.search(
        r"--flicker-instants N\s+Compare the light at this many instants\.\s+\[default: 8\]", shown.stdout
    )
    (line,) = shown.stderr.splitlines()
    assert line.startswith("the plugin 'broken' of simulshot.studies does not load: No module named")


@pytest.mark.slow
def test_comparison_and_report_contain_the_study(package: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ("--study", "flicker", "--flicker-instants", 2, "--out", out, "--json")
    done = reconstruct(package, "compare", SESSION, *options)
    result = json.loads(done.stdout)
    assert result == json.loads((out / "metrics.json").read_text())
    flicker = study(result, "flicker")
    assert flicker["instants"] == 2
    assert flicker["facts"]["brightest_instant"] in (0, 1)
    assert values(flicker).keys() == values(flicker, "offset").keys() == {"difference"}
    assert study(result, "stereo")["unasked"]
    assert "The light was measured at 2 instants." in result["verdict"]
    page = (out / "report.html").read_text()
    for words in ("How the light flickers", "Brightness difference", "<dt>Flicker</dt>", 'id="flicker"'):
        assert words in page
