"""Options described once: what Python is given is checked as the commands check it."""

from typing import Any

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from reconstruction import CompareOptions, Multiview, Stereo
from reconstruction.common.options import checked


@pytest.mark.parametrize(
    ("kind", "given", "said"),
    [
        (Stereo, {"instant": -1}, "instant cannot be -1"),
        (Stereo, {"instant": 1.5}, "Expected `int`, got `float` - at `$.instant`"),
        (Stereo, {"pair": ("cam00",)}, "Expected `array` of length 2, got 1 - at `$.pair`"),
        (Multiview, {"multiview_width": 10}, "multiview_width cannot be 10"),
        (Multiview, {"matcher": "best"}, "Invalid enum value 'best' - at `$.matcher`"),
    ],
)
def test_what_a_command_would_refuse_is_refused_by_name(kind: Any, given: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInputError) as refused:
        checked(kind(**given))
    assert refused.value.what == f"{kind.__name__}: {said}"


def test_numpys_numbers_are_numbers() -> None:
    given: Any = {"instants": tuple(np.arange(3)), "time_shifts_ms": {"cam00": np.float32(0.5)}}
    options = checked(Multiview(**given))
    assert options == Multiview(instants=(0, 1, 2), time_shifts_ms={"cam00": 0.5})
    assert type(options.instants[0]) is int


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"instants": (), "page": True}, "leave out --instants"),
        ({"depth": True}, "need --instants"),
        ({"instants": (1,), "instant": 2}, "either --instant or --instants"),
    ],
)
def test_options_that_exclude_each_other_are_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Multiview(**wrong)


def test_a_mesh_is_made_of_one_instant_unless_it_is_to_be_quick() -> None:
    assert Multiview().makes_mesh
    assert not Multiview(quick=True).makes_mesh
    assert not Multiview(instants=()).makes_mesh
    assert Multiview(quick=True, mesh=True).makes_mesh


def test_options_of_all_methods_have_keywords_of_their_own_in_a_comparison() -> None:
    options = CompareOptions.of(stereo=("a", "b"), panorama=("a", "c"), max_multiview_instants=0, splats=True)
    assert options.of_studies["panorama"] == ("a", "c")
    with pytest.raises(BadInputError, match="instant is not an option of a comparison"):
        CompareOptions.of(instant=1)
