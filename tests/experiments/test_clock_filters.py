"""The clock experiment, short."""

import json
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.errors import ExitCode
from capture_app.experiments.clock_filters import claims as clock_claims
from capture_app.experiments.clock_filters import experiment as clock_filters


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_filters, "MESSAGES", 1000)
    monkeypatch.setattr(clock_filters, "CONVERGENCE", (10, 300, 1000))
    monkeypatch.setattr(clock_filters, "CONVERGENCE_TRIALS", 2)
    monkeypatch.setattr(clock_claims, "TRIALS", 1)


def test_the_same_seed_gives_the_same_figures_and_the_claims_hold(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments = ["experiment", "clock-filters", "--trials", "5", "--seed", "5", "--json"]
    assert run([*arguments, "--plot", str(tmp_path)]) == ExitCode.OK
    printed = capsys.readouterr().out
    assert run(arguments) == ExitCode.OK
    assert capsys.readouterr().out == printed
    assert (tmp_path / "clock-filters.png").stat().st_size > 10_000
    result = json.loads(printed)
    assert (result["kind"], result["seed"], result["trials"]) == ("simulated", 5, 5)
    ours = result["ours"]
    assert ours["coverage_hard_bound"] == 1.0
    assert ours["coverage_95"] > 0.9
    assert ours["gain_mean"] > 1.5
    held = ours["coverage_95_by_situation"]
    assert set(held) == set(clock_claims.SITUATIONS)
    assert held[clock_claims.FIRST]["all"] == ours["coverage_95_drawn"] > 0.8
    assert set(ours["error_us"]) == set(result["baseline"]["minimum"]["error_us"])
    assert ours["error_us"]["gamma 2"]["mean_abs"] < 40.0
    assert result["baseline"]["mean"]["error_us"]["gamma 2"]["mean_abs"] == pytest.approx(372, rel=0.15)


@pytest.mark.shared
def test_a_recorded_link_is_one_more_law(shared: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trace = shared / "footage" / "timing" / "wifi_rtt_offset_good.csv"
    arguments = ["experiment", "clock-filters", "--trials", "3", "--trace", str(trace), "--json"]
    assert run(arguments) == ExitCode.OK
    ours = json.loads(capsys.readouterr().out)["ours"]
    assert ours["coverage_hard_bound"] == 1.0
    assert ours["gain_by_law"]["recorded"] > 2.0


def test_a_recording_that_is_not_there_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["experiment", "clock-filters", "--trace", "nowhere.csv"]) == ExitCode.BAD_INPUT
    assert "nowhere.csv" in capsys.readouterr().err
