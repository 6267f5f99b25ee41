"""A study of another package, as docs/plugins.md shows it, in the ordinary command."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.documentation.pages import plugin_module
from tests.reconstruction.found import study, values

ROOT = Path(__file__).resolve().parents[3]
SESSION = ROOT / "sample_sessions" / "jumper"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of the recipe, and one whose study does not load."""
    folder = tmp_path_factory.mktemp("installed")
    for heading, group in (("A study", "simulshot.studies"), ("A method", "simulshot.methods")):
        recipe = (ROOT / "docs" / "plugins.md").read_text().partition(f"\n## {heading}\n")[2]
        module, metadata = plugin_module(recipe), re.search(r"```toml\n(.*?)```", recipe, re.DOTALL)[1]
        ((name, target),) = tomllib.loads(metadata)["project"]["entry-points"][group].items()
        (folder / f"{target.partition(':')[0]}.py").write_text(module)
        install(folder, name, target, group)
    install(folder, "broken", "no_such_module:Study", "simulshot.studies")
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
    assert re.search(
        r"--flicker-instants N\s+Compare the light at this many instants\.\s+\[default: 8\]", shown.stdout
    )
    (line,) = shown.stderr.splitlines()
    assert line.startswith("the plugin 'broken' of simulshot.studies does not load: No module named")


def test_a_method_has_its_command_and_is_a_method_of_an_open_session(package: Path, tmp_path: Path) -> None:
    assert "average" in reconstruct(package, "--help").stdout
    assert "[default: 4; x>=1]" in reconstruct(package, "average", "--help").stdout
    out = tmp_path / "out"
    done = reconstruct(package, "average", SESSION, "--count", 2, "--condition", "cam00=33", "--out", out)
    assert done.stdout == f"cam00: {out / 'pictures' / 'average.png'}\n"
    result = json.loads((out / "metrics.json").read_text())
    assert (result["camera"], result["changed_pictures"]) == ("cam00", [])
    assert result["versions"]["numpy"]
    code = f"from reconstruction import open_session; s = open_session({str(SESSION)!r}); "
    code += "m = s.average(instant=1, count=2); print(m.image(m.result.picture).shape, 'average' in dir(s))\n"
    code += "try: s.average(count=0)\nexcept Exception as error: print(error)"
    run = [sys.executable, "-c", code]
    shown = subprocess.run(run, env=environment(package), capture_output=True, text=True, check=True).stdout
    assert shown.splitlines() == [
        "(480, 640, 3) True",
        "Average: count cannot be 0 (help(Average) shows what it takes)",
    ]


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
