"""The common shape of all experiments, and the command around it."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import click.testing
import pytest
from click.testing import CliRunner

from capture_app.cli import run
from capture_app.commands.experiment.command import plain_command
from capture_app.errors import ExitCode
from capture_app.experiments.common.plots import new_figure, save
from capture_app.experiments.common.result import Outcome, Result, error_figures, side_by_side

RESULT = Result(
    name="fake",
    kind="simulated",
    seed=3,
    trials=2,
    ours={"total_us": {"mean_abs": 12.345, "max": 40.0}},
    baseline={"total_us": {"mean_abs": 376.0}},
    paper={"total_us": {"mean_abs": 32, "max": 121}, "tries": 5},
)


def fake_run(*, trials: int | None, seed: int, talk: Callable[[str], None]) -> Outcome:
    talk("working")
    assert (trials, seed) == (None, 3)

    def draw(folder: Path) -> list[Path]:
        figure = new_figure(figsize=(2, 2))
        figure.subplots().plot([0, 1])
        return [save(figure, folder / "fake.png")]

    return Outcome(RESULT, notes=("a note",), draw=draw)


def run_fake(*arguments: str) -> click.testing.Result:
    fake = plain_command("fake", "A made-up one.", lambda: SimpleNamespace(run=fake_run))
    return CliRunner().invoke(fake, arguments)


def test_figures_stand_side_by_side() -> None:
    assert side_by_side(RESULT).rows == [
        ("total_us.mean_abs", "12.3", "376.0", "32"),
        ("total_us.max", "40.0", "-", "121"),
        ("tries", "-", "-", "5"),
    ]


def test_error_figures() -> None:
    figures = error_figures([3.0, -5.0])
    assert figures == {"mean_abs": 4.0, "max": 5.0, "std": 4.0, "bias": -1.0}
    with pytest.raises(ValueError, match="no errors"):
        error_figures([])


def test_json_is_data_and_talk_is_on_stderr() -> None:
    printed = run_fake("--seed", "3", "--json")
    assert printed.exit_code == ExitCode.OK
    assert json.loads(printed.stdout)["ours"] == {"total_us": {"mean_abs": 12.345, "max": 40.0}}
    assert printed.stderr == "working\n"


def test_table_and_pictures(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "plots"
    printed = run_fake("--seed", "3", "--plot", str(folder))
    assert printed.exit_code == ExitCode.OK
    assert (folder / "fake.png").stat().st_size > 1000
    assert "fake: simulated, 2 trials, seed 3" in printed.stdout
    assert "a note" in printed.stdout
    assert "fake.png" in printed.stderr


def test_a_missing_extra_is_said_before_the_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert run(["experiment", "naive", "--plot", str(tmp_path)]) == ExitCode.NOT_AVAILABLE
    assert "pip install 'matplotlib>=" in capsys.readouterr().err


def test_an_unknown_experiment_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["experiment", "nonsense"]) == ExitCode.USAGE
    assert "nonsense" in capsys.readouterr().err
