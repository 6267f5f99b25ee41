"""Pairing that is skipped, for one command."""

import asyncio

import pytest

from capture_app.common.child import Child
from capture_app.common.errors import SimulshotError, UnknownMachineError
from capture_app.rig.membership import accept_any_machine, is_pairing_skipped, own_machine
from capture_app.trust.trust import OPEN_VARIABLE, Trust


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


async def test_a_child_of_an_open_rig_skips_pairing_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(OPEN_VARIABLE, "0")
    asks = ("timeit", "-n1", "-r1", f"import os; assert os.environ['{OPEN_VARIABLE}'] == '1'")
    open_child = await Child.start("open", asks, variables=Trust.open().variables)
    assert await open_child.output()
    with pytest.raises(SimulshotError):
        await (await Child.start("paired", asks)).output()
