"""The studies, small: what they find, that the same seed gives the same figures, and that they draw."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from benchmarks.paper import (
    clock_cases,
    clock_changes,
    clock_filters,
    clock_paper,
    led_panel,
    naive,
    phase,
    scale,
)
from benchmarks.paper.__main__ import main
from benchmarks.paper.clock_trials import FIRST_SECOND, SITUATIONS
from benchmarks.paper.phase_cases import CASES, run_cases
from benchmarks.paper.report import PARTS
from benchmarks.paper.result import Outcome
from benchmarks.paper.values import LEAST_ROUND_TRIP, TABLE_3
from capture_app.common.errors import ExitCode

SHORT = clock_filters.StudySize(
    messages=1000,
    convergence=(10, 300, 1000),
    convergence_trials=2,
    coverage_trials=1,
    cases=clock_cases.CASES[:1],
    case_trials=1,
    changes=clock_changes.CASES[:1],
)


def draw(outcome: Outcome, folder: Path) -> list[Path]:
    pytest.importorskip("matplotlib")
    return outcome.draw(folder)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_figures_and_the_claims_on_clocks_hold(tmp_path: Path) -> None:
    outcome, again = (clock_filters.run(trials=5, seed=5, size=SHORT) for _ in range(2))
    assert msgspec.json.encode(again.result) == msgspec.json.encode(outcome.result)
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
    minimum = result["baseline"]["minimum"]
    assert result["baseline"]["mean"]["error_us"]["gamma 2"]["mean_abs"] == pytest.approx(372, rel=0.15)
    assert (
        ours["error_us"]["paper"]["mean_abs"]
        < 0.7 * result["baseline"]["minimum"]["error_us"]["paper"]["mean_abs"]
    )
    assert ours["error_us"]["paper"]["mean_abs"] < 0.7 * minimum["error_us"]["paper"]["mean_abs"]
    assert ours["table_3"]["bias.mean"] == pytest.approx(372, rel=0.1)
    # Without skew the minimum filter stays where its quickest message is.
    assert minimum["error_us_after"]["1000"]["mean_abs"] < 60.0
    paths = draw(outcome, tmp_path)
    assert "clock-filters.png" in [path.name for path in paths]
    assert all(path.stat().st_size > 10_000 for path in paths)


@pytest.mark.slow
def test_the_papers_messages_are_what_its_tables_and_figures_say(tmp_path: Path) -> None:
    part = {one.of.key: one for one in clock_paper.paper_part(share=0.02, seed=2)}
    assert set(part) == set(PARTS["clock_paper"])
    # Put in, and met within what chance allows two runs.
    for name in ("round_trip.mean", "round_trip.least", "bias.mean"):
        assert part["table-3"].protocol.values[name] == pytest.approx(TABLE_3[name], rel=0.03)
    for name in LEAST_ROUND_TRIP.names:
        assert part["least-round-trip"].protocol.values[name] == pytest.approx(
            LEAST_ROUND_TRIP[name], rel=0.05
        )
    # Without skew the minimum filter ends on its asymmetry, with skew the engine's alone is right.
    papers, ours = part["figure-s2"].protocol.values, part["figure-s2"].default
    assert ours is not None
    assert papers["minimum.10000"] == pytest.approx(19.0, abs=10.0)
    assert papers["ours.300"] < papers["minimum.300"]
    assert ours.values["ours.10000"] < 60.0 < ours.values["minimum.10000"]
    pytest.importorskip("matplotlib")
    for key in ("figure-7", "figure-s1", "figure-s2"):
        figure = part[key].draw
        assert figure is not None
        assert figure(tmp_path / f"{key}.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_command_prints_the_figures_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["clock-filters", "--trials", "1", "--json"]) == ExitCode.OK
    result = json.loads(capsys.readouterr().out)
    assert result["name"] == "clock-filters"
    cases = {case["name"]: case for case in result["cases"]}
    assert {"skew 1000 ppm", "slewed leader", "warming crystal", "asymmetry 20 %", "bursty link"} <= set(
        cases
    )
    for case in cases.values():
        assert case["hard_bound_held"] == 1.0, case
        assert 0.0 <= case["stated_95_held"] <= 1.0
        assert case["mean_us"] <= case["max_us"]
    assert cases["slewed leader"]["mean_us"] < 100.0
    assert cases["slewed leader"]["stated_95_held"] > 0.85


@pytest.mark.slow
def test_phase_sets_ours_beside_the_papers_way(tmp_path: Path) -> None:
    outcome = phase.run(trials=2, seed=3, groups={2: 1.0, 3: 1.0}, servo_s=12, cases=CASES[:1], jobs=1)
    ours, theirs = outcome.result.ours, outcome.result.baseline
    assert ours["injections_mean"]["unknown-phones"]["injection-with-profile"] <= 1.0
    assert ours["injections_mean"]["unknown-phones"]["injection"] <= 2.5
    assert set(ours["restarts_mean"]["webcam-x3"]) == {"uniform", "aimed", "aimed-with-profile"}
    assert theirs["seconds_mean"]["webcam-x3"]["restart"] > ours["seconds_mean"]["webcam-x3"]["aimed"]
    assert ours["servo_us"]["p99"] < 16.0
    assert set(ours["one_phone_restarts"]) == set(outcome.result.paper["one_phone_restarts"])
    assert theirs["one_phone_restarts"]["mean"] > 10.0, "one chance in 33"
    assert len(theirs["ten_phones_seconds_mean"]) == 3
    assert any("webcam-x3" in row for table in outcome.tables for row in table.rows)
    assert all(path.stat().st_size > 10_000 for path in draw(outcome, tmp_path))


@pytest.mark.slow
def test_cases_of_phase_are_judged_by_the_truth() -> None:
    names = ("gain 1.45", "gain 2", "stamps of 1 ms, cut", "latency of 12 frames", "skew 300 ppm, injection")
    some = tuple(case for case in CASES if case.name in names)
    found: dict[str, Any] = {str(case["name"]): case for case in run_cases(3, 5, cases=some, jobs=1)}
    assert set(found) == set(names)
    assert found == {case["name"]: case for case in run_cases(3, 5, cases=some, jobs=1)}
    hopeless = found.pop("skew 300 ppm, injection")
    # It passes through its tolerance, and nobody takes that for being held.
    assert hopeless["called_aligned_time_share"] == hopeless["false_aligned_share"] == 0.0
    for case in found.values():
        assert case["aligned_share"] == case["within_5_share"] == 1.0
        assert case["false_aligned_share"] == case["false_stuck_share"] == 0.0
        assert case["injections_mean"] <= case["injections_max"] <= 5
    assert found["gain 1.45"]["injections_mean"] > found["gain 2"]["injections_mean"] <= 2.5
    coarse = found["stamps of 1 ms, cut"]
    assert 100.0 < coarse["worst_error_us"] <= coarse["tolerance_in_force_max_us"] < 1200.0


@pytest.mark.slow
def test_two_phones_take_pictures_of_the_panel_that_tell_their_times(tmp_path: Path) -> None:
    outcome = led_panel.run(trials=1, seed=1)
    ours, oracle = outcome.result.ours, outcome.result.baseline["oracle_clock_us"]
    assert abs(ours["total_us"]["bias"] - ours["true_total_us"]["bias"]) < 15.0
    assert ours["total_us"]["max"] < 121.0
    assert ours["phase_us"]["max"] < 21.0
    assert 1.0 <= ours["injections_mean"] <= 5.5
    assert ours["by_default"]["hard_bound_held_share"] == 1.0
    assert set(ours["scatter_20_us"]) == set(ours["by_default"])
    assert oracle["max"] < 20.0
    assert [path.name for path in draw(outcome, tmp_path)] == ["led-panel.png", "led-panel-pictures.png"]


@pytest.mark.slow
def test_known_mechanisms_explain_a_part_of_the_papers_naive_triggers(tmp_path: Path) -> None:
    outcome = naive.run(trials=400, seed=2, least_chain_trials=1)
    modelled, paper = outcome.result.baseline, outcome.result.paper
    # The distance of two evenly drawn frames is a third of the period on average, a whole one at most.
    assert modelled["wired_ms"]["mean_abs"] == pytest.approx(33 / 3, abs=1.5)
    assert modelled["wired_ms"]["max"] <= 33
    assert 0 < modelled["usb_ms"]["mean_abs"] - modelled["wired_ms"]["mean_abs"] < 3
    for name, least in (("wired", 0.0), ("bluetooth", 11.0), ("wifi", 40.0)):
        assert least < modelled[f"{name}_ms"]["mean_abs"] < paper[f"{name}_ms"]["mean_abs"]
    assert (paper["wired_ms"]["failed_of_20"], paper["bluetooth_ms"]["failed_of_20"]) == (2, 1)
    assert outcome.result.ours["total_us"]["max"] < 150.0
    assert [path.name for path in draw(outcome, tmp_path)] == ["naive.png"]
    (table,) = naive.paper_part(share=0.1, seed=2)
    assert table.protocol.values["wifi.mean"] == pytest.approx(modelled["wifi_ms"]["mean_abs"], rel=0.1)


@pytest.mark.slow
def test_one_leader_beside_a_tree(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two = (
        scale.run(
            trials=1,
            seed=2,
            options=scale.ScaleOptions(sizes=(6,), minutes=1.2, jobs=jobs, shard_clients=3),
        )
        for jobs in (1, 2)
    )
    tree, alone = one.result.ours["6"], one.result.baseline["one_leader"]["6"]
    assert (tree["relays"], alone["relays"]) == (2, 0)
    for figures in (tree, alone):
        assert figures["coverage_hard_bound"] == 1.0
        assert 0.0 < figures["pair_error_us"]["median"] < figures["pair_error_us"]["p99"] < 400.0
    assert tree["leader_messages_per_s"] > 0.0 < tree["relay_messages_per_s"]
    assert len(capsys.readouterr().err.splitlines()) == 4
    again = two.result.ours["6"]
    assert (again["digest"], again["pair_error_us"]) == (tree["digest"], tree["pair_error_us"])
    assert len(tree["pair_error_us"]["p99_by_minute"]) == 2
    assert [path.read_bytes()[1:4] for path in draw(one, tmp_path)] == [b"PNG"]
