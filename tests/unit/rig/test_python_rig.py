"""A rig as Python's users have it, in a script or in a notebook."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from capture_app import AsyncRig, Rig
from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError, NetworkError
from capture_app.common.node_state import NodeState
from capture_app.protocol.orders import AddSimulated, StopRig
from capture_app.rig import rig as python_rig
from capture_app.rig.process import LeaderRecord
from capture_app.trust.trust import Trust
from tests.cheap_rig import rig_of, start_leader
from tests.unit.tui.fake_rig import FakeRig, make_node


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


@pytest.mark.virtual
async def test_all_cameras_that_are_here_are_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    fake, settling = FakeRig(), make_node("cam01", NodeState.ALIGNING)
    fake.nodes = (make_node("cam00"), settling)

    async def status(_: Address) -> Any:
        return fake.status()

    monkeypatch.setattr(python_rig, "ask_status", status)
    waiting = asyncio.create_task(AsyncRig("127.0.0.1").wait_until_ready(1))
    await asyncio.sleep(5.0)
    assert not waiting.done()
    fake.nodes = (make_node("cam00"), make_node("cam01"))
    assert len((await waiting).nodes) == 2


async def test_a_rig_that_cannot_add_its_cameras_is_ended(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    given = list[Any]()

    async def start(**_: Any) -> LeaderRecord:
        return LeaderRecord(pid=1, leader="127.0.0.1:9", sessions=str(tmp_path), started_unix_ns=0)

    async def give(_: Address, order: Any) -> None:
        given.append(order)
        if isinstance(order, AddSimulated):
            raise NetworkError("the leader is lost")

    monkeypatch.setattr(python_rig, "start_rig", start)
    monkeypatch.setattr(python_rig, "give_order", give)
    monkeypatch.setattr(system, "is_running", lambda _: False)
    with pytest.raises(NetworkError):
        await AsyncRig(simulated=2).__aenter__()
    assert given == [AddSimulated(cameras=2), StopRig()]
