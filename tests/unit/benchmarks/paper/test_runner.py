"""What all studies share: their figures, and the command line that runs them."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.paper import __main__ as runner
from benchmarks.paper.result import Outcome, Result, Table, error_figures
from capture_app.common.errors import ExitCode
from capture_app.console.terminal import talk

RESULT = Result(
    name="fake",
    kind="simulated",
    seed=3,
    trials=2,
    ours={"total_us": {"mean_abs": 12.345, "max": 40.0}},
    baseline={"total_us": {"mean_abs": 376.0}},
    paper={"total_us": {"mean_abs": 32, "max": 121}, "tries": 5},
)


def fake_run(*, trials: int | None, seed: int) -> Outcome:
    talk("working")
    assert (trials, seed) == (None, 3)

    return Outcome(RESULT, (Table(("figure", "ours"), [("total", "12.3")]),), ("a note",))


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "STUDIES", {"fake": "a made-up one"})
    monkeypatch.setitem(sys.modules, "benchmarks.paper.fake", SimpleNamespace(run=fake_run))


def test_error_figures() -> None:
    figures = error_figures([3.0, -5.0])
    assert figures == {"mean_abs": 4.0, "max": 5.0, "std": 4.0, "bias": -1.0}
    with pytest.raises(ValueError, match="no errors"):
        error_figures([])


@pytest.mark.usefixtures("fake")
def test_json_is_data_and_talk_is_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    assert runner.main(["fake", "--seed", "3", "--json"]) == ExitCode.OK
    printed = capsys.readouterr()
    assert json.loads(printed.out)["ours"] == {"total_us": {"mean_abs": 12.345, "max": 40.0}}
    assert "working\n" in printed.err


@pytest.mark.usefixtures("fake")
def test_a_study_prints_its_table_and_notes(capsys: pytest.CaptureFixture[str]) -> None:
    assert runner.main(["fake", "--seed", "3"]) == ExitCode.OK
    printed = capsys.readouterr()
    assert "fake: simulated, 2 trials, seed 3" in printed.out
    assert "12.3" in printed.out
    assert "a note" in printed.out


@pytest.mark.usefixtures("fake")
def test_without_a_name_all_of_it_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    assert runner.main(["--seed", "3", "--json", "--only", "table-1"]) == ExitCode.OK
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["fake", "paper"]
    assert [table["key"] for table in found["paper"]["tables"]] == ["table-1"]
    assert {"paper.md", "paper.json"} <= {path.name for path in (tmp_path / "paper").iterdir()}


def test_a_missing_extra_is_said_before_the_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert runner.main(["paper", "--out", str(tmp_path)]) == ExitCode.NOT_AVAILABLE
    assert "matplotlib" in capsys.readouterr().err


def test_an_unknown_name_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        runner.main(["nonsense"])
    assert ended.value.code == ExitCode.USAGE
    said = capsys.readouterr().err
    assert "nonsense" in said
    assert "--shards" in said
