"""What a leader's session and its nodes owe each other, in histories that are drawn.

No image is deleted that the leader has not safely, what was decided stays, each image is saved or said to be
missing, and everything ends.
"""

import asyncio
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.node.burst.duty import FAULTS, NAMES, USUAL, happen, small_batches
from tests.virtual.in_process import virtual_loop


def of_steps(faults: set[str]) -> st.SearchStrategy[list[tuple[str, str, int]]]:
    """Return histories of what is usual and of these faults."""
    steps = st.sampled_from((*USUAL, *USUAL, *sorted(faults)))
    return st.lists(st.tuples(steps, st.sampled_from(NAMES), st.integers(0, 5)), max_size=80)


HISTORIES = st.sets(st.sampled_from(FAULTS), max_size=2).flatmap(of_steps)


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    """One loop in virtual time for all histories."""
    loop = virtual_loop()
    with pytest.MonkeyPatch.context() as patch:
        small_batches(patch)
        yield loop
    loop.close()


@pytest.mark.parametrize("streamed", [False, True])
@given(HISTORIES)
def test_each_image_is_saved_or_said_to_be_missing(
    streamed: bool, loop: asyncio.AbstractEventLoop, history: list[tuple[str, str, int]]
) -> None:
    loop.run_until_complete(happen(streamed, history))
