"""Errors of calls that a file system does not have."""

import errno

import pytest

from capture_app.common.file_system_limits import is_missing


@pytest.mark.parametrize(
    ("call", "error", "missing"),
    [
        ("fsync", errno.EINVAL, True),
        ("fsync", errno.EIO, False),
        ("flock", errno.ENOLCK, True),
        ("flock", errno.EWOULDBLOCK, False),
        ("link", errno.EPERM, True),
        ("link", errno.EEXIST, False),
        ("chmod", errno.EPERM, True),
        ("renameat2", errno.EEXIST, False),
        ("renameat2", None, False),
    ],
)
def test_an_error_tells_a_call_that_is_missing_from_one_that_failed(
    call: str, error: int | None, missing: bool
) -> None:
    assert is_missing(call, error) is missing
