"""Planted faults change the product's code for a while; a run shows uncertainties that are wrong."""

import dataclasses
import random

import pytest

from capture_app.sync.rig.frame_selection import RingBuffer
from tests.virtual.evidence import TimeError
from tests.virtual.invariants import misjudged
from tests.virtual.planted import FAULTS, PlantError


@pytest.mark.parametrize("name", FAULTS)
def test_each_planted_fault_has_its_place_in_the_product(name: str) -> None:
    with FAULTS[name].planted():
        pass


def test_a_planted_fault_is_gone_after_its_run() -> None:
    ring: RingBuffer[str] = RingBuffer()
    for local_ns, frame in ((10, "first"), (20, "second")):
        ring.add(local_ns, frame)
    with FAULTS["ring"].planted():
        assert ring.nearest(20) == (20, "first")
    assert ring.nearest(20) == (20, "second")


@pytest.mark.parametrize(
    ("before", "why"),
    [
        ("a line that is not there any more", "has 0 times instead of once"),
        ("self", "times instead of once"),
        ("RING_NS, RING_BYTES = ", "is in no function"),
    ],
)
def test_a_fault_whose_place_has_changed_fails(before: str, why: str) -> None:
    with pytest.raises(PlantError, match=why), dataclasses.replace(FAULTS["ring"], before=before).planted():
        pass


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0, ""),
        (0.5, "95 % uncertainties are too narrow"),
        (0.35, "95 % uncertainties are too narrow"),
        (4.0, "95 % uncertainties are 8"),
    ],
)
def test_a_run_shows_uncertainties_that_are_wrong_by_a_factor(factor: float, words: str) -> None:
    chance = random.Random(1)
    times = [
        (seed, TimeError("cam0", (1, 1), abs(round(chance.gauss(0, 50_000))), round(factor * 100_000), True))
        for seed in range(1_200)
    ]
    assert [found[: len(words)] for found in misjudged(times)] == [words] * bool(words)
    # Few links show nothing.
    assert list(misjudged(times[:30])) == []
