"""Options and plans of staggered rigs."""

import pytest

from capture_app.common.errors import BadInputError
from capture_app.common.stagger import Stagger, describe_steps


def test_even_steps_are_in_the_order_of_names_and_of_their_numbers() -> None:
    plan_ns = Stagger.parse("even").plan_ns(["cam10", "cam2", "cam1"], 33_000_000)
    assert plan_ns == {"cam1": 0, "cam2": 11_000_000, "cam10": 22_000_000}
    assert Stagger().plan_ns([], 33_000_000) == {}


def test_listed_delays_are_as_they_are_listed() -> None:
    plan_ns = Stagger.parse("cam0=0ms, cam1=8.3ms,cam2=16.7").plan_ns(["cam1", "cam2", "cam3"], 33_000_000)
    assert plan_ns == {"cam1": 8_300_000, "cam2": 16_700_000, "cam3": 0}


@pytest.mark.parametrize("text", ["even", "cam0=0.0ms,cam1=8.3ms"])
def test_an_order_is_written_as_it_is_read(text: str) -> None:
    assert str(Stagger.parse(text)) == text
    assert Stagger.parse_or_off(text) == Stagger.parse(text)
    assert Stagger.parse_or_off("off") is None


@pytest.mark.parametrize(
    "text",
    ["", "odd", "cam0", "cam0=", "cam0=x", "cam0=-1ms", "cam0=nan", "cam0=501ms", "cam0=1,cam0=2", "=3ms"],
)
def test_anything_else_is_refused_with_what_is_possible(text: str) -> None:
    with pytest.raises(BadInputError, match="stagger") as error:
        Stagger.parse(text)
    assert "cam0=0ms,cam1=8.3ms" in (error.value.hint or "")


def test_the_steps_are_described_in_milliseconds() -> None:
    assert describe_steps([0, 8_333_333, 16_666_666, 25_000_000]) == "steps of 8.33 ms"
    assert describe_steps([0, 0, 8_000_000, 20_000_000]) == "steps of 8 to 12 ms"
    assert describe_steps([0, 0]) == "no steps"
