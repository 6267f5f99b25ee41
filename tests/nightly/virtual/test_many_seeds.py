"""Hundreds of rigs drawn by seed keep what they promise, and a hundred of them find each planted fault."""

import pytest

from tests.virtual.planted import FAULTS, TRIED
from tests.virtual.run import hunt, judged_together, run_seed

SEEDS, TOGETHER = 300, 50
"""Seeds of a night, and how many are judged together: one alone does not show uncertainties too wide."""


@pytest.mark.parametrize("first", range(0, SEEDS, TOGETHER))
def test_seeds(first: int) -> None:
    results = judged_together(map(run_seed, range(first, first + TOGETHER)))
    failed = [result for result in results if result.failures]
    assert not failed, "\n".join(f"python -m tests.virtual {of.seed} --verbose\n{of}" for of in failed)


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_is_found(name: str) -> None:
    found = hunt(name)
    assert found.seed is not None, f"{TRIED} seeds do not find this fault: {FAULTS[name].what}"
