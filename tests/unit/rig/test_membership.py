"""Pairing that is skipped: for one command, and for the processes that it starts."""

import asyncio
from pathlib import Path

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import UnknownMachineError
from capture_app.rig.membership import accept_any_machine, is_pairing_skipped, own_machine
from capture_app.rig.process import AttachedRig


async def test_pairing_is_skipped_within_a_block_its_tasks_and_its_processes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("SIMULSHOT_OPEN", "0")
    rig = AttachedRig(Address("127.0.0.1", 47010), Path("sessions"), is_local=True)
    assert "--open" not in rig.screen_arguments
    with accept_any_machine():
        assert is_pairing_skipped()
        assert await asyncio.to_thread(is_pairing_skipped)
        assert rig.screen_arguments[-1] == "--open"
        with pytest.raises(UnknownMachineError, match="leave out --open"):
            own_machine()
    assert not is_pairing_skipped()
