"""The clock experiment, short."""

import json
from pathlib import Path

import msgspec
import pytest

from capture_app.cli import run
from capture_app.errors import ExitCode
from capture_app.experiments.clock_filters import experiment as clock_filters
from capture_app.experiments.clock_filters.coverage import FIRST_SECOND, SITUATIONS

SHORT = clock_filters.StudySize(
    messages=1000, convergence=(10, 300, 1000), convergence_trials=2, coverage_trials=1
)


def test_the_same_seed_gives_the_same_figures_and_the_claims_hold(tmp_path: Path) -> None:
    outcome, again = (clock_filters.run(trials=5, seed=5, talk=lambda _: None, size=SHORT) for _ in range(2))
    assert msgspec.json.encode(again.result) == msgspec.json.encode(outcome.result)
    assert outcome.draw is not None
    outcome.draw(tmp_path)
    assert (tmp_path / "clock-filters.png").stat().st_size > 10_000
    result = msgspec.to_builtins(outcome.result)
    assert (result["kind"], result["seed"], result["trials"]) == ("simulated", 5, 5)
    ours = result["ours"]
    assert ours["coverage_hard_bound"] == 1.0
    assert ours["coverage_95"] > 0.9
    assert ours["gain_mean"] > 1.5
    held = ours["coverage_95_by_situation"]
    assert set(held) == set(SITUATIONS)
    assert held[FIRST_SECOND]["all"] == ours["coverage_95_drawn"] > 0.8
    assert set(ours["error_us"]) == set(result["baseline"]["minimum"]["error_us"])
    assert ours["error_us"]["gamma 2"]["mean_abs"] < 40.0
    assert result["baseline"]["mean"]["error_us"]["gamma 2"]["mean_abs"] == pytest.approx(372, rel=0.15)


@pytest.mark.shared
def test_a_recorded_link_is_one_more_law(shared: Path) -> None:
    trace = shared / "footage" / "timing" / "wifi_rtt_offset_good.csv"
    outcome = clock_filters.run(trials=3, seed=1, talk=lambda _: None, trace=trace, size=SHORT)
    ours = outcome.result.ours
    assert ours["coverage_hard_bound"] == 1.0
    assert ours["gain_by_law"]["recorded"] > 2.0


def test_the_command_prints_the_figures_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["experiment", "clock-filters", "--trials", "1", "--json"]) == ExitCode.OK
    assert json.loads(capsys.readouterr().out)["name"] == "clock-filters"


def test_a_recording_that_is_not_there_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["experiment", "clock-filters", "--trace", "nowhere.csv"]) == ExitCode.BAD_INPUT
    assert "nowhere.csv" in capsys.readouterr().err
