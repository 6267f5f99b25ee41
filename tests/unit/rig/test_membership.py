"""Pairing that is skipped, for one command."""

import asyncio

import pytest

from capture_app.common.errors import UnknownMachineError
from capture_app.rig.membership import accept_any_machine, is_pairing_skipped, own_machine


async def test_pairing_is_skipped_within_a_block_and_its_tasks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("SIMULSHOT_OPEN", "0")
    with accept_any_machine():
        assert is_pairing_skipped()
        assert await asyncio.to_thread(is_pairing_skipped)
        with pytest.raises(UnknownMachineError, match="leave out --open"):
            own_machine()
    assert not is_pairing_skipped()
