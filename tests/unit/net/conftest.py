"""Streams and datagrams byte by byte; who may speak on them is tested in tests/unit/trust."""

import pytest


@pytest.fixture(autouse=True)
def _open(open_rig: None) -> None:
    """Nobody is asked who it is."""
