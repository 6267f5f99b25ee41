"""A study of another package, as docs/plugins.md shows it, in the ordinary command."""

import json
import subprocess
import sys
from pathlib import Path

from tests.project import JUMPER
from tests.unit.reconstruction.found import study, values
from tests.unit.reconstruction.methods.test_plugin import (
    environment,
    package,  # noqa: F401 - a fixture
    reconstruct,
)

SESSION = JUMPER


def test_a_method_has_its_command_and_is_a_method_of_an_open_session(package: Path, tmp_path: Path) -> None:
    assert "average" in reconstruct(package, "--help").stdout
    assert "[default: 4; x>=1]" in reconstruct(package, "average", "--help").stdout
    out = tmp_path / "out"
    done = reconstruct(package, "average", SESSION, "--count", 2, "--condition", "cam00=33", "--out", out)
    assert done.stdout == f"result: {out}\n"
    result = json.loads((out / "metrics.json").read_text())
    assert (result["picture"], result["changed_pictures"]) == ("pictures/average.png", [])
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


def test_a_comparison_runs_the_method_and_scores_it(package: Path, tmp_path: Path) -> None:
    options = ("--study", "average", "--max-instants", 3, "--out", tmp_path / "out", "--json")
    result = json.loads(reconstruct(package, "compare", SESSION, *options).stdout)
    average = study(result, "average")
    assert average["instants"] == 3
    assert values(average)["contrast"] > values(average, "offset")["contrast"] > 0
    assert "--condition distinct@cam00" in average["commands"]["offset"]


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
