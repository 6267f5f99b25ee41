"""What is said of a child process that ends."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from capture_app.common.child import Child


@pytest.mark.parametrize(
    ("code", "line", "told"),
    [
        (-9, "cam03: burst 4 was cancelled", "it was killed"),
        (-11, "Fatal Python error: Segmentation fault", "Fatal Python error: Segmentation fault"),
        (3, "cam03: error: the camera is in use", "the camera is in use"),
    ],
)
async def test_a_child_that_was_killed_does_not_tell_what_it_logged_before(
    code: int, line: str, told: str
) -> None:
    stderr = asyncio.StreamReader()
    stderr.feed_data(f"{line}\n".encode())
    stderr.feed_eof()
    process: Any = SimpleNamespace(stderr=stderr, returncode=code)
    failure = await Child("cam03", process).failure()
    assert failure.what == f"cam03 ended with code {code}: {told}"
