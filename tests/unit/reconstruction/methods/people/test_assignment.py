"""The assignment of least cost, beside all others."""

from itertools import product

import numpy as np

from reconstruction.methods.people.assignment import assign


def test_no_other_assignment_costs_less() -> None:
    rng = np.random.default_rng(3)
    for _ in range(60):
        costs = np.where(rng.random((3, 4)) < 0.2, np.inf, rng.random((3, 4)))
        pairs = dict(assign(costs, 0.6))
        assert len(set(pairs.values())) == len(pairs)
        best = min(
            sum(0.6 if place < 0 else costs[row, place] for row, place in enumerate(choice))
            for choice in product(range(-1, 4), repeat=3)
            if len({place for place in choice if place >= 0}) == sum(place >= 0 for place in choice)
        )
        assert np.isclose(sum(costs[pair] for pair in pairs.items()) + 0.6 * (3 - len(pairs)), best)


def test_nobody_is_assigned_to_nothing() -> None:
    assert not [
        *assign(np.zeros((2, 0)), 1.0),
        *assign(np.zeros((0, 2)), 1.0),
        *assign(np.full((1, 1), 2.0), 1.0),
    ]
