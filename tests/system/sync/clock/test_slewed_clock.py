"""A clock that is slewed over WiFi, and comes back: is its node soon ready again, and not before?"""

from pathlib import Path

import pytest

from benchmarks.clock.ready_clocks import Slew, run_slew
from benchmarks.simulated.link_spells import LAWS, recorded_laws


@pytest.mark.parametrize("name", ["two states as recorded", "the same, 20 times as often"])
def test_a_node_is_ready_within_5_s_of_the_end_of_a_slew(name: str) -> None:
    figures = run_slew(name, LAWS[name], Slew(500.0, 15.0), range(1, 3), 0.0)
    again_s, false_s = figures["again_s"], figures["false_s"]
    assert isinstance(again_s, float)
    assert again_s < 5.0
    assert isinstance(false_s, float)
    assert false_s <= 2.0


@pytest.mark.parametrize("slew", [Slew(1_500.0, 10.0), Slew(3_000.0, 3.0)], ids=str)
@pytest.mark.parametrize("name", ["two states as recorded", "the same, 20 times as often", "roaming"])
def test_a_clock_slewed_beyond_measure_is_soon_ready_and_right(name: str, slew: Slew) -> None:
    """Its samples contradict each other each 0.3 s, so that its rate is never measured."""
    figures = run_slew(name, LAWS[name], slew, range(1, 3), 0.0)
    again_s, false_s = figures["again_s"], figures["false_after_s"]
    assert isinstance(again_s, float)
    assert again_s < 5.0
    assert isinstance(false_s, float)
    assert false_s <= 1.0


def test_a_queue_that_fills_as_a_clock_is_slewed_hides_none_of_its_samples() -> None:
    figures = run_slew("bufferbloat", LAWS["bufferbloat"], Slew(1_500.0, 10.0), range(3, 4), 0.0)
    again_s = figures["again_s"]
    assert isinstance(again_s, float)
    assert again_s < 10.0
    assert figures["false_after_s"] == 0.0


@pytest.mark.parametrize(
    ("slew", "false_after_s"), [(Slew(500.0, 15.0), 0.1), (Slew(3_000.0, 3.0), 2.0), (Slew(80.0, 15.0), 12.0)]
)
def test_noise_of_a_recorded_link_is_not_taken_for_the_end_of_a_slew(
    slew: Slew, false_after_s: float, shared: Path
) -> None:
    name = "recording, in order"
    link = recorded_laws(shared / "traces" / "wifi.txt")[name]
    figures = run_slew(name, link, slew, range(1, 4), 0.0)
    found_s, again_s = figures["false_after_s"], figures["again_s"]
    assert isinstance(found_s, float)
    assert found_s <= false_after_s
    assert isinstance(again_s, float)
    assert again_s < 5.0 or slew.ppm < 500.0
