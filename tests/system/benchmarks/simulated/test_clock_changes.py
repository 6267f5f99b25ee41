"""A node whose leader's clock, or whose way to it, changes says so, and never what is not true for long."""

import pytest

from tests.unit.benchmarks.simulated.test_clock_changes import figures, share


def test_a_small_change_of_the_rate_is_noticed_in_seconds() -> None:
    found = figures("80 ppm more, WiFi", 2)
    assert share(found, "unready_after_s") <= 12.0, "the gap shrinks by 80 us a second, of 1 ms"
    assert share(found, "false_ready") <= 0.08
    assert share(found, "stated_95_held") >= 0.85


@pytest.mark.parametrize("ms", ["0.2", "5"])
def test_an_increased_path_delay_widens_the_error_bar(ms: str) -> None:
    found = figures(f"one way {ms} ms longer, wire")
    assert share(found, "stated_95_held") >= 0.9
    assert share(found, "hard_bound_held") == 1.0
    assert share(found, "false_ready") == 0.0


@pytest.mark.parametrize(
    "ppm",
    ["3,000", "8,000", "83,333"],
)
def test_a_clock_slewed_beyond_the_premise_ends_ready_at_once(ppm: str) -> None:
    found = figures(f"{ppm} ppm for 3 s, wire")
    assert share(found, "unready_after_s") <= 0.6
    assert share(found, "false_ready") <= 0.02
    assert share(found, "hard_bound_held") == 1.0, "but near the two steps"
    assert share(found, "ready") > 0.7, "and it is ready again when the clock is"
