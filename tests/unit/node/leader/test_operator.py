"""What operators see of a leader and ask of it, over a connection that comes back."""

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, NetworkError, NotAvailableError, SimulshotError
from capture_app.node.leader import bursts
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol import log as log_module
from capture_app.protocol.log import MAX_LOG_LINES, Log
from capture_app.protocol.orders import (
    AddCamera,
    AddSimulated,
    CancelBurst,
    EndBurst,
    Order,
    RemoveCamera,
    StaggerCameras,
    StopRig,
)
from capture_app.protocol.status import BurstStatus, LogLine, RigStatus
from capture_app.rig.rig_link import LinkLost, RigLink, Update, ask_status, give_order
from capture_app.sync.rig.events import NodeChanged, TriggerAnswered
from capture_app.sync.timekeeping.rates import HostOffRate
from tests.cheap_rig import start_leader
from tests.waiting import SLOW_PATIENCE_S, until

TIMEOUT_S = 60.0


@pytest.fixture
async def leader(tmp_path: Path) -> AsyncIterator[LeaderNode]:
    async with await start_leader(tmp_path / "sessions") as node:
        yield node


async def next_of(updates: AsyncIterator[Update], wanted: Callable[[Update], bool]) -> Update:
    async with asyncio.timeout(TIMEOUT_S):
        async for update in updates:
            if wanted(update):
                return update
    raise AssertionError("the updates have ended")


async def test_a_link_begins_with_the_status_and_the_news_so_far(leader: LeaderNode) -> None:
    leader.log.add("a joined", camera="a")
    leader.log.add("lost a: it left", camera="a", level="warning")
    updates = RigLink(leader.own_address).updates()
    first = await next_of(updates, lambda _: True)
    assert isinstance(first, RigStatus)
    assert first.sessions_folder == str(leader.options.sessions)
    assert first.disk_free_bytes
    lines = [await next_of(updates, lambda update: isinstance(update, LogLine)) for _ in range(2)]
    assert [(line.text, line.level) for line in lines if isinstance(line, LogLine)] == [
        ("a joined", "info"),
        ("lost a: it left", "warning"),
    ]
    leader.log.add("a is back", camera="a")
    line = await next_of(updates, lambda update: isinstance(update, LogLine))
    assert isinstance(line, LogLine)
    assert line.text == "a is back"
    await updates.aclose()


async def test_a_session_that_was_renamed_is_not_named_any_more(leader: LeaderNode, tmp_path: Path) -> None:
    saved, renamed = tmp_path / "burst-001", tmp_path / "jump"
    saved.mkdir()
    leader.bursts.saved.extend([str(saved), str(tmp_path)])
    saved.rename(renamed)
    rig = await ask_status(leader.own_address)
    assert rig.sessions == (str(tmp_path),)


async def test_a_disk_that_hangs_does_not_stop_the_leader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a network share does whose server is started again: an operator's status asks for its room."""
    goes_on = threading.Event()

    def free_bytes(_: Path) -> int:
        goes_on.wait(SLOW_PATIENCE_S)
        return 7

    monkeypatch.setattr(bursts, "free_bytes", free_bytes)
    async with await start_leader(tmp_path) as node:
        try:
            assert (await ask_status(node.own_address)).disk_free_bytes is None
            assert not goes_on.is_set(), "the status did not wait for it"
        finally:
            goes_on.set()
        await until(lambda: node.status().disk_free_bytes == 7)


async def test_a_lost_leader_is_told_and_its_successor_is_shown_without_telling_news_twice(
    tmp_path: Path,
) -> None:
    first = await start_leader(tmp_path / "sessions")
    first.log.add("of the first run")
    link = RigLink(first.own_address)
    updates = link.updates()
    await next_of(updates, lambda update: isinstance(update, LogLine))
    await first.stop()
    lost = await next_of(updates, lambda update: isinstance(update, LinkLost))
    assert isinstance(lost, LinkLost)
    assert "closed the connection" in lost.reason
    port, folder = first.own_address.port, (tmp_path / "sessions").absolute()
    assert lost.reason.endswith(f": capture-app rig start --port {port} --sessions {folder}")
    async with await start_leader(tmp_path / "sessions", port=first.own_address.port) as second:
        await next_of(updates, lambda update: isinstance(update, RigStatus))
        second.log.add("of the second run")
        line = await next_of(updates, lambda update: isinstance(update, LogLine))
        assert isinstance(line, LogLine)
        assert line.text == "of the second run"
        await updates.aclose()


async def test_a_leader_that_is_not_there_is_told_once_and_waited_for(tmp_path: Path) -> None:
    async with await start_leader(tmp_path / "sessions") as gone:
        address = gone.own_address
    updates = RigLink(address).updates()
    assert isinstance(await next_of(updates, lambda _: True), LinkLost)
    coming = asyncio.ensure_future(next_of(updates, lambda _: True))
    await asyncio.sleep(0.3)
    async with await start_leader(tmp_path / "sessions", port=address.port):
        assert isinstance(await coming, RigStatus)
        await updates.aclose()


async def test_a_port_without_a_leader_is_an_error_for_one_request() -> None:
    with pytest.raises(NetworkError, match="no leader at"):
        await ask_status(Address("127.0.0.1", 9))


async def test_a_leader_takes_another_port_where_it_may(leader: LeaderNode, tmp_path: Path) -> None:
    taken = leader.own_address.port
    with pytest.raises(NetworkError, match="cannot listen on"):
        await start_leader(tmp_path / "other", port=taken)
    async with await start_leader(tmp_path / "other", port=taken, or_free_port=True) as other:
        assert other.own_address.port not in (0, taken)
        await ask_status(other.own_address)


@pytest.mark.parametrize(
    "order", [AddSimulated(cameras=2), AddCamera(spec="sim")], ids=["simulated", "camera"]
)
async def test_a_leader_without_a_spool_starts_no_cameras(leader: LeaderNode, order: Order) -> None:
    with pytest.raises(NotAvailableError, match="runs no cameras"):
        await give_order(leader.own_address, order)


async def test_simulated_cameras_that_cannot_start_say_why(tmp_path: Path) -> None:
    (tmp_path / "spool").write_text("a file")
    async with await start_leader(tmp_path / "sessions", spool=tmp_path / "spool") as leader:
        with pytest.raises(SimulshotError, match="spool' is a file"):
            await give_order(leader.own_address, AddSimulated(cameras=2, scene="bars"))


async def test_a_scene_has_so_many_views(tmp_path: Path) -> None:
    async with await start_leader(tmp_path / "sessions", spool=tmp_path / "spool") as leader:
        for cameras, scene in ((8, "studio"), (0, "bars"), (65, "bars")):
            with pytest.raises(BadInputError, match="further simulated cameras"):
                await give_order(leader.own_address, AddSimulated(cameras=cameras, scene=scene))
        with pytest.raises(BadInputError, match="no simulated scene 'moon'"):
            await give_order(leader.own_address, AddSimulated(cameras=1, scene="moon"))


async def test_an_operator_ends_the_leader(leader: LeaderNode) -> None:
    await RigLink(leader.own_address).order(StopRig())
    async with asyncio.timeout(TIMEOUT_S):
        await leader.service.stop_requested.wait()


async def test_orders_about_what_is_not_there_say_so(leader: LeaderNode) -> None:
    link = RigLink(leader.own_address)
    with pytest.raises(BadInputError, match="burst 7 is not under way"):
        await link.order(CancelBurst(burst=7))
    with pytest.raises(BadInputError, match="burst 7 is not a recording under way"):
        await link.order(EndBurst(burst=7))
    with pytest.raises(BadInputError, match="sideways"):
        await link.order(StaggerCameras(order="sideways"))
    with pytest.raises(BadInputError, match="no node named never-joined"):
        await give_order(leader.own_address, RemoveCamera(name="never-joined"))


def test_the_news_keep_the_last_lines_in_the_order_of_their_times(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter((5, 3, 9, 9))
    monkeypatch.setattr(log_module, "MAX_LOG_LINES", 3)
    monkeypatch.setattr(time, "time_ns", lambda: next(clock))
    log = Log()
    log.note(NodeChanged("a", "joined"))
    log.note(NodeChanged("a", "lost", "it left"))
    log.note(NodeChanged("a", "lost", "it left"))
    log.note(TriggerAnswered("b", 1, "no clock"))
    log.note(BurstStatus(burst=1, name="x", cameras=1, instants=1, received=0, expected=1))
    done: dict[str, Any] = {"burst": 1, "name": "x", "cameras": 1, "instants": 1, "expected": 1, "done": True}
    log.note(BurstStatus(received=1, session="/s/x", **done))
    assert [(line.unix_ns, line.camera, line.level) for line in log.after(0)] == [
        (6, "a", "warning"),
        (9, "b", "warning"),
        (10, None, "info"),
    ]
    assert [line.unix_ns for line in log.after(6)] == [9, 10]


def test_a_line_that_is_said_once_comes_again_when_the_log_has_forgotten_it() -> None:
    log = Log((shown := list[str]()).append)
    for line in ("full", "full", "busy", "full"):
        log.say_once(line)
    assert shown == ["full", "busy"]
    for number in range(MAX_LOG_LINES):
        log.say(f"{number}")
    shown.clear()
    log.say_once("full")
    assert shown == ["full"]


def test_what_happens_in_a_rig_is_a_line_of_json_by_a_name_of_its_own() -> None:
    told: list[dict[str, object]] = []
    log = Log(record=told.append)
    log.note(NodeChanged("a", "joined"))
    log.note(NodeChanged("a", "moved", where="below"))
    log.note(NodeChanged("a", "moved"))
    log.note(NodeChanged("a", "lost", "it left"))
    log.note(NodeChanged("b", "refused", "the rig is full", "at 10.0.0.2"))
    log.note(TriggerAnswered("a", 1))
    log.note(TriggerAnswered("b", 1, "no clock"))
    log.note(HostOffRate("a", 210.0, ambiguous=True))
    log.note(HostOffRate("a", 0.0))
    assert told == [
        {"event": "node-joined", "name": "a"},
        {"event": "node-moved", "name": "a", "relay": "below"},
        {"event": "node-moved", "name": "a", "relay": None},
        {"event": "node-lost", "name": "a", "reason": "it left"},
        {"event": "node-refused", "name": "b", "where": "at 10.0.0.2", "reason": "the rig is full"},
        {"event": "burst-accepted", "name": "a", "burst": 1},
        {"event": "burst-refused", "name": "b", "burst": 1, "reason": "no clock"},
        {"event": "host-off-rate", "name": "a", "fast_ppm": 210.0, "ambiguous": True},
        {"event": "host-at-rate", "name": "a"},
    ]
