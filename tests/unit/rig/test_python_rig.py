"""A rig as Python's users have it, in a script or in a notebook."""

import asyncio
from pathlib import Path

from capture_app import AsyncRig, Rig
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader


async def test_a_notebook_joins_a_rig_by_the_trust_in_use(tmp_path: Path) -> None:
    trust = Trust(tmp_path / "trust")

    async def notebook() -> str:
        """Wait for each call while a loop is running already."""
        with Rig(str(leader.own_address)) as rig:
            return rig.status().leader

    with trust.in_use():
        async with await start_leader(tmp_path / "sessions", trust=trust) as leader:
            assert await asyncio.to_thread(asyncio.run, notebook()) == str(leader.address)


def test_the_name_that_people_guess_waits_too() -> None:
    assert Rig.wait_ready is Rig.wait_until_ready
    assert AsyncRig.wait_ready is AsyncRig.wait_until_ready
