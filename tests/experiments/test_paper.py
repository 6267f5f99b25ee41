"""The paper's tables and figures: what an experiment may hand over, and the page made of it."""

import pytest

from capture_app.experiments.common.paper_values import FIGURE_6, TABLE_2, TABLE_3
from capture_app.experiments.common.reproduction import Measured, Reproduction, share_of
from capture_app.experiments.paper.parts import PARTS, all_of_the_paper


def test_a_number_of_the_paper_by_its_name() -> None:
    assert (TABLE_2["total.max"], TABLE_3["bias.least"]) == (121.0, 19.0)
    with pytest.raises(KeyError):
        TABLE_2["total.median"]


def test_names_and_keys_are_used_once() -> None:
    keys = [one.key for one in all_of_the_paper()]
    assert len(set(keys)) == len(keys) >= 16
    for one in all_of_the_paper():
        assert len(set(one.names)) == len(one.names) > 0
    measured = [key for keys in PARTS.values() for key in keys]
    assert len(set(measured)) == len(measured)
    assert set(measured) <= set(keys)


def test_a_name_that_the_paper_does_not_have_is_refused() -> None:
    ours = Measured({"total.mean": 20.0, "total.median": 15.0}, 5, "tolerance 20 us")
    with pytest.raises(ValueError, match=r"table-2 has no total\.median"):
        Reproduction(of=TABLE_2, seed=1, protocol=ours, default=None, simulated="All.")


def test_a_figure_without_a_drawing_is_refused() -> None:
    ours = Measured({"total.max": 60.0}, 5, "tolerance 20 us")
    with pytest.raises(ValueError, match="figure-6 is a figure"):
        Reproduction(of=FIGURE_6, seed=1, protocol=ours, default=None, simulated="All.")


@pytest.mark.parametrize(("share", "trials"), [(1.0, 239), (0.1, 24), (0.001, 2)])
def test_a_share_of_the_trials(share: float, trials: int) -> None:
    assert share_of(239, share) == trials
