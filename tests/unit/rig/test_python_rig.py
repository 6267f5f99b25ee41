"""A rig as Python's users have it, in a script or in a notebook."""

import asyncio
from pathlib import Path

import pytest

from capture_app import AsyncRig, Rig
from capture_app.common.errors import IncompleteError
from capture_app.trust.trust import Trust
from tests.cheap_rig import rig_of, start_leader


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


@pytest.mark.virtual
async def test_a_preview_shows_all_cameras_at_one_instant(tmp_path: Path, open_rig: None) -> None:
    async with rig_of(2, tmp_path) as leader:
        rig = AsyncRig(str(leader.own_address))
        await rig.wait_until_ready(2)
        shown = await rig.preview(160)
    assert {*shown.previews} == {"cam00", "cam01"}
    assert {one.instant_ns for one in shown.previews.values()} == {shown.instant_ns}


@pytest.mark.virtual
async def test_waiting_for_cameras_that_are_not_there_ends_with_an_error(
    tmp_path: Path, open_rig: None
) -> None:
    async with await start_leader(tmp_path) as leader:
        rig = AsyncRig(str(leader.own_address))
        with pytest.raises(IncompleteError, match="0 of 2 cameras are ready after 3 s"):
            await rig.wait_until_ready(2, timeout_s=3)
        with pytest.raises(IncompleteError, match="no synchronized camera gave a preview within 2 s"):
            await rig.preview(wait_s=2)
