"""Restarts at random and aimed ones, against start latencies of several kinds."""

import random
from collections.abc import Callable

import pytest

from tests.unit.sync.phase.test_reset import MS, PERIOD_NS, tries


def steady(sd_ms: float) -> Callable[[random.Random], float]:
    return lambda rng: rng.gauss(280, sd_ms) * MS


def test_random_restarts_take_as_many_tries_as_chance_says() -> None:
    assert tries(steady(2), MS, aimed=False, rounds=220) == pytest.approx(PERIOD_NS / (2 * MS), rel=0.2)


@pytest.mark.parametrize(("sd_ms", "at_most"), [(0.2, 1.1), (2.0, 3.2), (5.0, 8.0)])
def test_aimed_restarts_take_few(sd_ms: float, at_most: float) -> None:
    assert tries(steady(sd_ms), MS, aimed=True, rounds=200) < at_most


def test_a_latency_that_cannot_be_predicted_costs_no_more_than_chance() -> None:
    assert tries(steady(60), 2 * MS, aimed=True, rounds=200) < 1.25 * PERIOD_NS / (4 * MS)
