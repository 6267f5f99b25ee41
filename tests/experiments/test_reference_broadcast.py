"""`experiment reference-broadcast`: less apart where it should be, the same bytes for the same seed."""

from pathlib import Path

import pytest

from capture_app.experiments import load
from capture_app.experiments.reference_broadcast import experiment as reference_broadcast
from capture_app.experiments.reference_broadcast.experiment import CASES, run


def test_it_halves_what_it_should_and_leaves_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference_broadcast, "SECONDS", 11)
    monkeypatch.setattr(reference_broadcast, "SETTLED_S", 9)
    monkeypatch.setattr(reference_broadcast, "CASES", {name: CASES[name] for name in ("pair", "copies")})
    one, two = (run(trials=1, seed=3, talk=lambda _: None) for _ in range(2))
    assert one.result == two.result
    ours, alone = one.result.ours, one.result.baseline
    with_us, without_us = (f["pair"]["between_clients_us"]["mean_abs"] for f in (ours, alone))
    assert with_us < without_us / 2
    assert ours["pair"]["in_use_share"] == 1.0
    assert ours["copies"]["in_use_share"] == 0.0
    assert ours["copies"]["between_clients_us"] == alone["copies"]["between_clients_us"]
    assert all(figures["coverage_hard_bound"] == 1.0 for figures in (*ours.values(), *alone.values()))
    assert len(one.tables[0].rows[0]) == len(one.tables[0].head)


def test_it_is_in_the_table_and_draws(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(reference_broadcast, "SECONDS", 4)
    monkeypatch.setattr(reference_broadcast, "SETTLED_S", 3)
    monkeypatch.setattr(reference_broadcast, "CASES", {"pair": CASES["pair"]})
    outcome = load("reference-broadcast").run(trials=1, seed=1, talk=lambda _: None)
    assert outcome.draw is not None
    (path,) = outcome.draw(tmp_path)
    assert path.stat().st_size > 10_000
