"""The studies, small: what they find, that the same seed gives the same figures, and that they draw."""

import pytest

from benchmarks.paper import (
    naive,
)


def test_known_mechanisms_explain_a_part_of_the_papers_naive_triggers() -> None:
    (table,) = naive.paper_part(share=0.4, seed=2)
    modelled, paper = table.protocol.values, table.of
    # The distance of two evenly drawn frames is a third of the period on average, a whole one at most.
    assert modelled["wired.mean"] == pytest.approx(33 / 3, abs=1.5)
    assert modelled["wired.max"] <= 33
    for name, least in (("wired", 0.0), ("bluetooth", 11.0), ("wifi", 40.0)):
        assert least < modelled[f"{name}.mean"] < paper[f"{name}.mean"]
