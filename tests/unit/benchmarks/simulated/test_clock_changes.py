"""A node whose leader's clock, or whose way to it, changes says so, and never what is not true for long."""

from benchmarks.clock.clock_changes import CASES, ChangeFigures, run_case

BY_NAME = {case.name: case for case in CASES}


def figures(name: str, trials: int = 1) -> ChangeFigures:
    return run_case(BY_NAME[name], trials, "test").figures()


def share(found: ChangeFigures, name: str) -> float:
    value = found[name]
    assert isinstance(value, float | int)
    return value


def test_an_outage_with_a_warming_crystal_is_reported_as_it_is() -> None:
    assert share(figures("hold-over, warming, wire"), "stated_95_held") >= 0.9
    all_along = figures("hold-over, warming all along, wire")
    used = share(all_along, "mean_us") / share(all_along, "stated_us")
    assert 0.8 < used < 1.05, "two sigma of the premise: the bar is as wide as that asks for, and no wider"
