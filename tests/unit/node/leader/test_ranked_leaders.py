"""Leaders of a rig by rank: who leads alone, who gives way, and lists that name no machine or two."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, NetworkError
from capture_app.common.tasks import end
from capture_app.net.server import bind_port
from capture_app.node.leader import standby
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.standby import ContinuedClock, lead_by_rank
from capture_app.protocol.log import Log
from capture_app.sync.clock.time_map import TimeMap
from tests.cheap_rig import start_leader
from tests.unit.node.camera.controlled_camera import StillClock
from tests.unit.node.enrolment.test_standby import free_address
from tests.waiting import until

pytestmark = [pytest.mark.usefixtures("open_rig"), pytest.mark.virtual]


class Ranked:
    """A machine that leads by its rank in a task; `nodes` are those with which it has led."""

    def __init__(self, folder: Path, own: Address, leaders: Sequence[Address]) -> None:
        self.log, self.nodes, self.over = Log(), list[LeaderNode](), asyncio.Event()
        self._options = LeaderOptions(sessions=folder, host=own.host, port=own.port, log=self.log)
        self.task = asyncio.create_task(lead_by_rank(lambda: self._options, leaders, self._lead))

    async def _lead(self, node: LeaderNode) -> None:
        self.nodes.append(node)
        await self.over.wait()

    @property
    def lines(self) -> list[str]:
        return [line.text for line in self.log.after(0)]


def is_free(address: Address) -> bool:
    try:
        for sock in bind_port(*address):
            sock.close()
    except NetworkError:
        return False
    return True


async def test_a_leader_without_others_leads_at_once_until_it_is_done(tmp_path: Path) -> None:
    own = free_address()
    for leaders in ([], [own]):
        ranked = Ranked(tmp_path, own, leaders)
        await until(lambda of=ranked: of.nodes, seconds=1.0)  # type: ignore[misc]
        assert ranked.nodes[0].own_address == own
        ranked.over.set()
        await ranked.task


async def test_a_standby_follows_leads_and_gives_way_to_a_better_one(tmp_path: Path) -> None:
    better, own = free_address(), free_address()
    ranked = Ranked(tmp_path / "second", own, [better, own])
    try:
        async with await start_leader(tmp_path / "first", port=better.port) as leader:
            await until(lambda: ranked.lines)
            assert ranked.lines == [f"{better} leads: this one follows until that leader is lost"]
            await until(lambda: any(of.name.startswith("leader-") for of in leader.status().nodes))
            assert not ranked.nodes
        await until(lambda: ranked.nodes)
        assert not is_free(own)
        async with await start_leader(tmp_path / "first", port=better.port):
            await until(lambda: any("this one stops leading" in line for line in ranked.lines), seconds=60.0)
            await until(lambda: is_free(own))
            assert len(ranked.nodes) == 1
        await until(lambda: len(ranked.nodes) == 2, seconds=60.0)
        ranked.over.set()
        await ranked.task
    finally:
        await end(ranked.task)


async def test_an_error_of_the_one_that_leads_is_that_of_the_program(tmp_path: Path) -> None:
    other, own = free_address(), free_address()

    async def lead(_: LeaderNode) -> None:
        raise NetworkError("the screen is gone")

    options = LeaderOptions(sessions=tmp_path, host=own.host, port=own.port)
    before = asyncio.all_tasks()
    with pytest.raises(NetworkError, match="the screen is gone"):
        await lead_by_rank(lambda: options, [own, other], lead)
    await until(lambda: asyncio.all_tasks() <= before)


async def test_a_list_of_leaders_has_this_machine_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, other = free_address(), free_address()
    monkeypatch.setattr(standby, "own_hosts", lambda _: ["10.0.0.9"])
    for leaders in (
        [other, other],
        [Address("10.0.0.8", own.port), other],
        [own, own],
        [own, Address("10.0.0.9", own.port)],
    ):
        ranked = Ranked(tmp_path, own, leaders)
        with pytest.raises(BadInputError, match=f"one must be this machine's, on port {own.port}"):
            await ranked.task
        assert not ranked.nodes


async def test_a_port_that_is_in_use_is_told_before_it_is_needed(tmp_path: Path) -> None:
    async with await start_leader(tmp_path / "other") as leader:
        own = leader.own_address
        ranked = Ranked(tmp_path, own, [free_address(), own])
        with pytest.raises(NetworkError, match="cannot listen on"):
            await ranked.task


def test_a_continued_clock_goes_on_with_the_time_of_the_leader_before() -> None:
    time_map = TimeMap(
        epoch_local_ns=0, offset_ns=5 * 10**9, skew=1e-4, uncertainty_ns=1.0, hard_bound_ns=1.0,
        skew_uncertainty=0.0, skew_bound=0.0, samples=1, round_trip_ns=1,
    )  # fmt: skip
    clock = ContinuedClock(StillClock(), time_map)
    assert clock.now_ns() == time_map.leader_from_local(10**9)
    for true_ns in (0, 10**12):
        shown_ns = clock.local_from_true(true_ns)
        assert shown_ns == time_map.leader_from_local(StillClock().local_from_true(true_ns))
        assert abs(clock.true_from_local(shown_ns) - true_ns) <= 1
