"""Each law of a WiFi link shows what its source says of it, within what chance allows."""

import pytest

from benchmarks.simulated.wifi_laws import LINKS_BY_LAW
from tests.unit.benchmarks.simulated.test_link_laws import STATISTICS, misses


@pytest.mark.parametrize("name", [name for name in LINKS_BY_LAW if name != "paper"])
def test_each_law_shows_what_its_assumption_demands(name: str) -> None:
    assert misses(LINKS_BY_LAW[name], STATISTICS[name]) == []


@pytest.mark.parametrize("name", ["gamma 2", "lognormal 0.6"])
def test_laws_above_one_floor_are_not_the_papers_link(name: str) -> None:
    wrong = " ".join(misses(LINKS_BY_LAW[name], STATISTICS["paper"]))
    assert "least of 300" in wrong
    assert "to the" not in wrong
