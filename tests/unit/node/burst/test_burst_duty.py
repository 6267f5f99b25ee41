"""What a leader's session and its nodes owe each other, in histories that are drawn.

No image is deleted that the leader has not safely, what was decided stays, each image is saved or said to be
missing, and everything ends.
"""

import asyncio
from collections.abc import Iterator

import pytest
from hypothesis import given, settings

from tests.histories import histories
from tests.unit.node.burst.duty import FAULTS, NAMES, USUAL, happen, small_batches
from tests.virtual.in_process import virtual_loop


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    """One loop in virtual time for all histories."""
    loop = virtual_loop()
    with pytest.MonkeyPatch.context() as patch:
        small_batches(patch)
        yield loop
    loop.close()


@pytest.mark.parametrize("streamed", [False, True])
@settings(max_examples=60)
@given(histories((*USUAL, *USUAL), FAULTS, max_steps=60, numbers=12))
def test_each_image_is_saved_or_said_to_be_missing(
    streamed: bool, loop: asyncio.AbstractEventLoop, history: list[tuple[str, int]]
) -> None:
    at_cameras = ((step, NAMES[number % 2], number // 2) for step, number in history)
    loop.run_until_complete(happen(streamed, at_cameras))
