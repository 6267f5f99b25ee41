"""The common shape of all experiments, and the command around it."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from capture_app import experiments
from capture_app.cli import run
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


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(experiments.EXPERIMENTS, "fake", "A made-up one.")
    monkeypatch.setattr(experiments, "import_module", lambda name: SimpleNamespace(run=fake_run))


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


@pytest.mark.usefixtures("fake")
def test_json_is_data_and_talk_is_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["experiment", "fake", "--seed", "3", "--json"]) == ExitCode.OK
    printed = capsys.readouterr()
    assert json.loads(printed.out)["ours"] == {"total_us": {"mean_abs": 12.345, "max": 40.0}}


@pytest.mark.usefixtures("fake")
def test_table_and_pictures(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "plots"
    assert run(["experiment", "fake", "--seed", "3", "--plot", str(folder)]) == ExitCode.OK
    assert (folder / "fake.png").stat().st_size > 1000
    printed = capsys.readouterr()
    assert "fake: simulated, 2 trials, seed 3" in printed.out
    assert "a note" in printed.out
    assert "fake.png" in printed.err


@pytest.mark.usefixtures("fake")
def test_a_missing_extra_is_said_before_the_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    assert run(["experiment", "fake", "--plot", str(tmp_path)]) == ExitCode.NOT_AVAILABLE
    assert "simulshot[plots]" in capsys.readouterr().err


def test_an_unknown_experiment_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["experiment", "nonsense"]) == ExitCode.USAGE
    assert "nonsense" in capsys.readouterr().err
