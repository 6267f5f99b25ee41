"""What operators see of a leader and ask of it, over a connection that comes back."""

import asyncio
import contextlib
from contextlib import aclosing
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.protocol.orders import (
    AddCamera,
    AddSimulated,
    RemoveCamera,
)
from capture_app.protocol.status import RigStatus
from capture_app.rig.rig_link import RigLink, Update, ask_status
from tests.cheap_rig import start_leader
from tests.unit.node.leader.test_operator import leader, next_of  # noqa: F401 - a fixture
from tests.waiting import time_limit, until


async def test_cameras_of_the_leaders_machine_come_and_go_by_order(tmp_path: Path) -> None:
    async with await start_leader(tmp_path / "sessions", spool=tmp_path / "spool") as leader:
        link = RigLink(leader.own_address)
        updates = link.updates()
        await link.order(AddCamera(spec="sim:webcam,scale=0.1", name="desk"))

        def shows_desk(update: Update) -> bool:
            return isinstance(update, RigStatus) and [n.name for n in update.nodes] == ["desk"]

        status = await next_of(updates, shows_desk)
        assert isinstance(status, RigStatus)
        assert status.nodes[0].on_leader
        with pytest.raises(BadInputError, match="desk already exists"):
            await link.order(AddCamera(spec="sim:webcam", name="desk"))
        with pytest.raises(BadInputError, match="unknown simulated camera 'nope'"):
            await link.order(AddCamera(spec="sim:nope"))
        with pytest.raises(BadInputError, match="unknown camera 'what'"):
            await link.order(AddCamera(spec="what"))
        with pytest.raises(BadInputError, match="no node named nobody"):
            await link.order(RemoveCamera(name="nobody"))
        await link.order(RemoveCamera(name="desk"))
        assert (await ask_status(leader.own_address)).nodes == ()
        await updates.aclose()


async def test_two_rigs_have_simulated_cameras_of_the_same_names(tmp_path: Path) -> None:
    async with contextlib.AsyncExitStack() as stack:
        for sessions in ("one", "two"):
            leader = await stack.enter_async_context(await start_leader(tmp_path / sessions))
            nodes = LocalNodes(leader.own_address, tmp_path / "spool", leader.log)
            await stack.enter_async_context(aclosing(nodes))
            assert await nodes.add_simulated(AddSimulated(cameras=1, scene="bars")) == ("cam00",)
            async with aclosing(RigLink(leader.own_address).updates()) as updates:
                await next_of(updates, lambda update: isinstance(update, RigStatus) and bool(update.nodes))
            assert list(nodes.specs) == ["cam00"]


async def test_a_camera_that_is_being_ended_is_ended_once_and_keeps_its_name(
    tmp_path: Path,
) -> None:
    async with (
        await start_leader(tmp_path / "sessions") as leader,
        aclosing(LocalNodes(leader.own_address, tmp_path / "spool")) as nodes,
    ):
        await nodes.add_camera("sim:webcam,scale=0.1", "desk")
        removals = [asyncio.create_task(nodes.remove("desk")) for _ in range(2)]
        await asyncio.sleep(0)
        with pytest.raises(BadInputError, match="desk already exists"):
            await nodes.add_camera("sim:webcam,scale=0.1", "desk")
        await asyncio.gather(*removals)
        assert list(nodes.specs) == []
        assert await nodes.add_camera("sim:webcam,scale=0.1", "desk") == "desk"


async def test_a_camera_whose_process_dies_is_started_again_unless_it_is_removed(tmp_path: Path) -> None:
    async with (
        await start_leader(tmp_path / "sessions") as leader,
        aclosing(LocalNodes(leader.own_address, tmp_path / "spool", leader.log)) as nodes,
    ):
        await nodes.add_camera("sim:webcam,scale=0.1", "desk")
        first = nodes._children["desk"].process
        first.kill()
        await until(lambda: nodes._children["desk"].process.pid != first.pid)
        await until(nodes._children["desk"].spoken.is_set)
        (told,) = [line.text for line in leader.log.after(0) if line.level == "error"]
        assert told.startswith("desk ended with code -9: it was killed")
        assert told.endswith("; it is started again in 1 s")
        nodes._children["desk"].process.kill()
        async with time_limit("its end"):
            await nodes._children["desk"].process.wait()
        await nodes.remove("desk")
        assert list(nodes.specs) == []


async def test_a_camera_that_does_not_open_is_not_started_again(tmp_path: Path) -> None:
    async with (
        await start_leader(tmp_path / "sessions") as leader,
        aclosing(LocalNodes(leader.own_address, tmp_path / "spool", leader.log)) as nodes,
    ):
        with pytest.raises(SimulshotError):
            await nodes.add_camera("sim:nope", "desk")
        await until(lambda: not nodes.specs)
