"""Histories for models of duties: what happens, step by step, each with a number."""

import random
from collections.abc import Sequence

from hypothesis import strategies as st


def histories(
    usual: Sequence[str],
    others: Sequence[str] = (),
    *,
    max_steps: int = 25,
    max_others: int = 2,
    numbers: int = 6,
) -> st.SearchStrategy[list[tuple[str, int]]]:
    """Return histories of what is usual and few kinds of the others, each step with a number below `numbers`.

    Each is drawn by a seed. Lists that Hypothesis draws itself are short and alike: of 100 with at most 60
    steps the mean has 7, and 28 begin with the four steps of another one.
    """

    def of_seed(seed: int) -> list[tuple[str, int]]:
        drawn = random.Random(seed)
        kinds = (*usual, *drawn.sample(others, min(len(others), drawn.randint(0, max_others))))
        return [(drawn.choice(kinds), drawn.randrange(numbers)) for _ in range(drawn.randint(1, max_steps))]

    return st.integers(0, 2**32).map(of_seed)
