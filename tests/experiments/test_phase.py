"""The experiments `phase`, `led-panel` and `naive`, small: what they find, and that it is drawn."""

import random
from pathlib import Path
from statistics import mean, stdev

import pytest

from capture_app.experiments.led_panel import experiment as led_panel
from capture_app.experiments.naive import experiment as naive
from capture_app.experiments.phase import experiment as phase


def nothing(_: str) -> None:
    """Nobody listens."""


def test_phase_sets_ours_beside_the_papers_way(tmp_path: Path) -> None:
    outcome = phase.run(trials=2, seed=3, talk=nothing, groups={2: 1.0, 3: 1.0}, servo_s=12, jobs=1)
    ours, theirs = outcome.result.ours, outcome.result.baseline
    assert ours["injections_mean"]["unknown-phones"]["injection-with-profile"] <= 1.0
    assert ours["injections_mean"]["unknown-phones"]["injection"] <= 2.5
    assert set(ours["restarts_mean"]["webcam-x3"]) == {"uniform", "aimed", "aimed-with-profile"}
    assert theirs["seconds_mean"]["webcam-x3"]["restart"] > ours["seconds_mean"]["webcam-x3"]["aimed"]
    assert ours["servo_us"]["p99"] < 16.0
    assert len(theirs["ten_phones_seconds_mean"]) == 3
    assert any("webcam-x3" in row for table in outcome.shown() for row in table.rows)
    pytest.importorskip("matplotlib")
    assert outcome.draw is not None
    assert all(path.stat().st_size > 10_000 for path in outcome.draw(tmp_path))


def test_two_phones_take_pictures_of_the_panel_that_tell_their_times(tmp_path: Path) -> None:
    outcome = led_panel.run(trials=1, seed=1, talk=nothing)
    ours = outcome.result.ours
    assert abs(ours["total_us"]["bias"] - ours["true_total_us"]["bias"]) < 15.0
    assert ours["total_us"]["max"] < 121.0
    assert ours["phase_us"]["max"] < 21.0
    pytest.importorskip("matplotlib")
    assert outcome.draw is not None
    assert [path.name for path in outcome.draw(tmp_path)] == ["led-panel.png", "led-panel-pictures.png"]


@pytest.mark.parametrize("law", naive.PAPERS.values(), ids=naive.PAPERS)
def test_modelled_triggers_have_the_papers_figures(law: naive.TriggerErrors) -> None:
    rng = random.Random(2)
    sizes = [law.draw_ms(rng) for _ in range(2000)]
    assert max(sizes) <= law.largest_ms
    assert mean(sizes) == pytest.approx(law.mean_ms, rel=0.05)
    assert stdev(sizes) == pytest.approx(law.std_ms, rel=0.05)


def test_triggers_are_read_off_pictures_beside_the_chain(tmp_path: Path) -> None:
    outcome = naive.run(trials=1, seed=2, talk=nothing, least_chain_trials=1)
    for name, law in naive.PAPERS.items():
        drawn_ms = law.draw_ms(random.Random(f"2/{name}"))
        assert outcome.result.baseline[f"{name}_ms"]["mean_abs"] == pytest.approx(drawn_ms, abs=0.05)
    assert outcome.result.ours["total_us"]["max"] < 121.0
    pytest.importorskip("matplotlib")
    assert outcome.draw is not None
    assert [path.name for path in outcome.draw(tmp_path)] == ["naive.png"]
