"""Processes that a leader starts on its own machine, drawn: their options, and the page for phones."""

import asyncio
import json
import os
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from capture_app.cameras.specs import parse_spec
from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, CameraError, NetworkError
from capture_app.common.timeouts import NODE_START_TIMEOUT_S, PHONES_START_TIMEOUT_S
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.protocol.log import Log
from capture_app.protocol.orders import FLAT_SCENES, AddSimulated, PhoneInvited
from capture_app.trust.trust import Trust

pytestmark = pytest.mark.virtual
LEADER = Address("10.0.0.1", 47010)


class Process:
    """A process that has just been started; the test says what it prints, and when it ends."""

    def __init__(self, name: str, arguments: Any) -> None:
        self.name, self.arguments = name, [*arguments]
        self.ended, self.spoken, self.is_stopped = asyncio.Event(), asyncio.Event(), False
        self._lines: asyncio.Queue[bytes | None] = asyncio.Queue()
        self.process = SimpleNamespace(returncode=None, wait=self.ended.wait, stdout=self._printed())

    async def _printed(self) -> AsyncIterator[bytes]:
        while (line := await self._lines.get()) is not None:
            yield line

    def say(self, line: str) -> None:
        self._lines.put_nowait(line.encode() + b"\n")

    def end(self) -> None:
        self.process.returncode = 1
        self._lines.put_nowait(None)
        self.ended.set()

    async def failure(self) -> CameraError:
        return CameraError(f"{self.name} ended")

    async def stop(self, _: float = 0.0) -> bool:
        self.is_stopped = True
        self.end()
        return True


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Process]:
    """The processes, in the order in which they were started."""
    processes = list[Process]()

    async def start(name: str, arguments: Any, *, variables: Any) -> Process:
        assert variables == Trust.open().variables
        processes.append(Process(name, arguments))
        return processes[-1]

    monkeypatch.setattr("capture_app.node.leader.local_nodes.Child", SimpleNamespace(start=start))
    return processes


@pytest.fixture
def nodes(tmp_path: Path) -> LocalNodes:
    return LocalNodes(LEADER, tmp_path, Log(), trust=Trust.open())


def option(process: Process, name: str) -> str | None:
    """The value of an option of its command line; None without it."""
    given = process.arguments
    return given[given.index(name) + 1] if name in given else None


async def opened(started: list[Process]) -> None:
    """Let all cameras open."""
    await asyncio.sleep(1.0)
    for process in started:
        process.spoken.set()


async def test_a_camera_without_a_name_gets_none_that_is_taken(
    nodes: LocalNodes, started: list[Process]
) -> None:
    label = parse_spec("sim:perfect").label
    adding = asyncio.ensure_future(nodes.add_camera("sim:perfect", taken=[label]))
    await opened(started)
    assert await adding not in (label, "")


async def test_simulated_cameras_see_a_scene_from_its_free_views(
    nodes: LocalNodes, started: list[Process], tmp_path: Path
) -> None:
    order = AddSimulated(cameras=2, scene="studio", options="drops=0,fps=30", tolerance_us=70)
    adding = asyncio.ensure_future(nodes.add_simulated(order, taken=["cam01"]))
    await asyncio.sleep(1.0)
    assert not adding.done()
    await opened(started)
    assert await adding == ("cam00", "cam02")
    assert [process.name for process in started] == ["cam00", "cam02"]
    assert [option(process, "--camera") for process in started] == [
        "sim:phone-a,scene=studio,view=cam00,drops=0,fps=30",
        "sim:phone-b,scene=studio,view=cam02,drops=0,fps=30",
    ]
    for process in started:
        assert process.arguments[:3] == ["capture_app.cli", "node", "--until-eof"]
        assert (option(process, "--leader"), option(process, "--spool")) == (str(LEADER), str(tmp_path))
        assert (option(process, "--clock"), option(process, "--tolerance-us")) == ("sim", "70")
    assert [*nodes.specs] == ["cam00", "cam02"]
    adding = asyncio.ensure_future(nodes.add_simulated(AddSimulated(cameras=1, scene="bars", options="")))
    await opened(started)
    assert await adding == ("cam01",)
    assert option(started[2], "--camera") == "sim:phone-a,scene=bars"
    assert option(started[2], "--tolerance-us") is None
    await nodes.aclose()
    assert all(process.is_stopped for process in started)
    assert not nodes.specs


async def test_a_scene_without_free_views_says_how_many_it_has(
    nodes: LocalNodes, started: list[Process]
) -> None:
    for cameras in (3, 0):
        with pytest.raises(BadInputError, match=f"{cameras} further simulated cameras of the scene") as none:
            await nodes.add_simulated(AddSimulated(cameras=cameras, scene="crossing"), taken=["cam01"])
        assert none.value.hint == f"it has 3 views, 2 of them free; any number can use {FLAT_SCENES[0]}"
    with pytest.raises(BadInputError, match="further simulated") as none:
        await nodes.add_simulated(AddSimulated(cameras=65, scene="bars"))
    assert none.value.hint == "it has 64 views, 64 of them free"
    assert not started


async def test_a_camera_that_does_not_open_says_why_and_a_slow_one_is_not_waited_for(
    nodes: LocalNodes, started: list[Process]
) -> None:
    adding = asyncio.ensure_future(nodes.add_camera("v4l2:/dev/video0", "cam"))
    await asyncio.sleep(1.0)
    assert not adding.done()
    started[0].end()
    with pytest.raises(CameraError, match="cam ended"):
        await adding
    assert not nodes.specs
    begun_s = asyncio.get_running_loop().time()
    assert await nodes.add_camera("v4l2:/dev/video1") == "video1"
    assert asyncio.get_running_loop().time() - begun_s == pytest.approx(NODE_START_TIMEOUT_S, abs=0.1)
    assert (option(started[1], "--clock"), option(started[1], "--camera")) == ("host", "v4l2:/dev/video1")
    await nodes.aclose()


async def test_a_device_that_is_being_closed_is_opened_again_under_the_same_name(
    nodes: LocalNodes, started: list[Process]
) -> None:
    adding = asyncio.ensure_future(nodes.add_camera("v4l2:/dev/video0", "cam"))
    await opened(started)
    await adding
    ending = asyncio.Event()

    async def stop(_: float = 0.0) -> bool:
        await ending.wait()
        started[0].end()
        return True

    started[0].stop = stop  # type: ignore[method-assign]
    removing = asyncio.ensure_future(nodes.remove("cam"))
    await asyncio.sleep(0.1)
    twice = asyncio.ensure_future(nodes.remove("cam"))
    again = asyncio.ensure_future(nodes.add_camera("v4l2:/dev/video0", "cam"))
    await asyncio.sleep(0.1)
    assert (removing.done(), twice.done(), len(started)) == (False, False, 1)
    ending.set()
    await removing
    await twice
    await opened(started)
    assert await again == "cam"
    assert len(started) == 2
    await nodes.aclose()


async def test_only_simulated_cameras_are_started_twice_by_one_spec(
    nodes: LocalNodes, started: list[Process]
) -> None:
    for spec in ("sim:perfect", "sim:perfect", "replay:a.mp4", "replay:a.mp4"):
        adding = asyncio.ensure_future(nodes.add_camera(spec))
        await opened(started)
        await adding
    assert [option(process, "--camera") for process in started] == [
        "sim:perfect",
        "sim:perfect",
        "replay:a.mp4",
    ]
    assert len(nodes.specs) == 3
    with pytest.raises(BadInputError, match="a node named CAM01 already exists"):
        await nodes.add_simulated(AddSimulated(cameras=7), taken=["CAM01"])
    await nodes.aclose()


async def test_a_password_is_neither_in_a_command_line_nor_in_a_status(
    nodes: LocalNodes, started: list[Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "environ", dict(os.environ))
    adding = asyncio.ensure_future(nodes.add_camera("rtsp://user:secret@10.0.0.3/x", "cam"))
    await opened(started)
    await adding
    assert option(started[0], "--camera") == nodes.specs["cam"] == "rtsp://user@10.0.0.3/x"
    await nodes.aclose()


async def test_a_node_of_another_machine_is_not_removed_here(nodes: LocalNodes) -> None:
    with pytest.raises(BadInputError, match="cam is not a node of this leader's machine"):
        await nodes.remove("cam")


def invitation(url: str) -> str:
    return json.dumps({"event": "invitation", "url": url, "fingerprint": "AB:CD", "good_for_s": 300})


async def test_phones_are_invited_by_one_server_until_it_ends(tmp_path: Path, started: list[Process]) -> None:
    log = Log()
    nodes = LocalNodes(LEADER, tmp_path, log, "10.0.0.7", trust=Trust.open())
    first, second = (asyncio.ensure_future(nodes.phones.invitation()) for _ in range(2))
    await asyncio.sleep(1.0)
    (server,) = started
    assert server.arguments[:2] == ["capture_app.cli", "phones"]
    assert (option(server, "--leader"), option(server, "--spool")) == (str(LEADER), str(tmp_path))
    assert option(server, "--host") == "10.0.0.7"
    server.say("not JSON")
    server.say(json.dumps({"event": "listening"}))
    await asyncio.sleep(1.0)
    assert not first.done()
    server.say(invitation("https://a"))
    for invited in await asyncio.gather(first, second):
        assert invited == PhoneInvited(url="https://a", fingerprint="AB:CD", good_for_s=300)
    await asyncio.sleep(100.0)
    assert (await nodes.phones.invitation()).good_for_s == 200
    server.say(invitation("https://b"))
    await asyncio.sleep(1000.0)
    assert await nodes.phones.invitation() == PhoneInvited(url="https://b", fingerprint="AB:CD", good_for_s=0)
    server.end()
    await asyncio.sleep(1.0)
    assert [(line.text, line.level) for line in log.after(0)] == [
        ("the phone server has ended; invite a phone to start it again", "error")
    ]
    again = asyncio.ensure_future(nodes.phones.invitation())
    await asyncio.sleep(1.0)
    assert (again.done(), len(started)) == (False, 2), "what the last one invited to is gone"
    started[1].say(invitation("https://c"))
    assert (await again).url == "https://c"
    started[1].end()
    await asyncio.sleep(1.0)
    again = asyncio.ensure_future(nodes.phones.invitation())
    await asyncio.sleep(1.0)
    started[2].end()
    with pytest.raises(CameraError, match="the phone server ended"):
        await again
    again = asyncio.ensure_future(nodes.phones.invitation())
    await asyncio.sleep(1.0)
    started[3].say(invitation("https://d"))
    await again
    before = list(log.after(0))
    await nodes.aclose()
    await asyncio.sleep(1.0)
    assert started[3].is_stopped
    assert list(log.after(0)) == before, "whoever ends the rig need not be told"


async def test_a_phone_server_that_fails_or_is_slow_says_so(
    nodes: LocalNodes, started: list[Process]
) -> None:
    asking = asyncio.ensure_future(nodes.phones.invitation())
    await asyncio.sleep(1.0)
    started[0].end()
    with pytest.raises(CameraError, match="the phone server ended"):
        await asking
    begun_s = asyncio.get_running_loop().time()
    with pytest.raises(NetworkError, match="has not started yet"):
        await nodes.phones.invitation()
    assert asyncio.get_running_loop().time() - begun_s == pytest.approx(PHONES_START_TIMEOUT_S, abs=0.1)
    await nodes.aclose()
    assert started[1].is_stopped
    await LocalNodes(LEADER, Path(), trust=Trust.open()).aclose()


async def test_phones_find_the_leader_where_it_has_no_further_address(
    nodes: LocalNodes, started: list[Process]
) -> None:
    asking = asyncio.ensure_future(nodes.phones.invitation())
    await asyncio.sleep(1.0)
    assert option(started[0], "--host") == LEADER.host
    asking.cancel()
    await nodes.aclose()
