"""Depth of an object by small rigs of several kinds, rendered; `make bench NAME=any-rig` has all of them."""

import pytest

from benchmarks.reconstruction.any_rig import measure
from benchmarks.reconstruction.rendered_rigs import RIGS, RenderedRig, render_rig


def render(name: str, *cameras: int) -> RenderedRig:
    """Some cameras of a rig, with one sample a pixel."""
    rig = RIGS[name]
    chosen = rig._replace(cameras=tuple(rig.cameras[number] for number in cameras))
    return render_rig(name, chosen, scale=0.6, samples=1)


@pytest.mark.parametrize(
    ("name", "cameras", "least", "false"),
    [
        ("ring of 12", (11, 0, 1), 0.6, 0.02),
        ("ring of 47, temple", (45, 46, 0, 1), 0.55, 0.01),
        ("two opposite, helpers", (0, 1, 2, 3), 0.65, 0.08),
    ],
)
def test_the_object_is_found_and_little_floats_beside_it(
    name: str, cameras: tuple[int, ...], least: float, false: float
) -> None:
    row = measure(render(name, *cameras))
    assert row["object_within_1pct"] > least
    assert row["object_wrong"] < 0.05
    assert row["points"] > 1000
    assert row["false_points"] < false
