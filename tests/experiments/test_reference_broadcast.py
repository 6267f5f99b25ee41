"""`experiment reference-broadcast`: less apart where it should be, the same bytes for the same seed."""

from pathlib import Path

from capture_app.experiments import load
from capture_app.experiments.reference_broadcast import experiment
from capture_app.experiments.reference_broadcast.experiment import CASES, run


def test_it_halves_what_it_should_and_leaves_the_rest() -> None:
    cases = {name: CASES[name] for name in ("pair", "copies")}
    one, two = (
        run(trials=1, seed=3, talk=lambda _: None, cases=cases, seconds=11, settled_s=9) for _ in range(2)
    )
    assert one.result == two.result
    ours, alone = one.result.ours, one.result.baseline
    with_us, without_us = (f["pair"]["between_clients_us"]["mean_abs"] for f in (ours, alone))
    assert with_us < without_us / 2
    assert ours["pair"]["in_use_share"] == 1.0
    assert ours["copies"]["in_use_share"] == 0.0
    assert ours["copies"]["between_clients_us"] == alone["copies"]["between_clients_us"]
    assert all(figures["coverage_hard_bound"] == 1.0 for figures in (*ours.values(), *alone.values()))
    assert len(one.tables[0].rows[0]) == len(one.tables[0].head)


def test_it_is_in_the_table_and_draws(tmp_path: Path) -> None:
    assert load("reference-broadcast") is experiment
    cases = {"pair": CASES["pair"]}
    outcome = run(trials=1, seed=1, talk=lambda _: None, cases=cases, seconds=4, settled_s=3)
    assert outcome.draw is not None
    (path,) = outcome.draw(tmp_path)
    assert path.stat().st_size > 10_000
