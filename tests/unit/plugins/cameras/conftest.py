"""Fixtures of tests of camera drivers."""

import pytest

from capture_app.cameras import base


@pytest.fixture(autouse=True)
def stamps_are_the_drivers_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames keep the times of CLOCK_MONOTONIC that drivers stamp, in which these tests know the truth."""
    monkeypatch.setattr(base, "host_from_monotonic", int)
