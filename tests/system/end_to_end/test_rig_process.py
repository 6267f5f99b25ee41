"""Rigs in the background: found again, left running, and ended with all that they started."""

import asyncio
import json
import os
import signal
import socket
from pathlib import Path

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, NetworkError
from capture_app.protocol.orders import StopRig
from capture_app.rig.process import attach, list_rigs, start_rig
from capture_app.rig.rig_link import ask_status, give_order
from tests.waiting import until

from .conftest import Start

CAMERA = "sim:webcam,scale=0.1"


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Records and spools of this test alone."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


def processes_with(text: str) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = path.read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if text in command and int(path.parent.name) != os.getpid():
            found.append(int(path.parent.name))
    return found


async def stop_all() -> None:
    for rig in list_rigs():
        await give_order(rig.address, StopRig())
    await until(lambda: not list_rigs())


async def test_a_screen_starts_a_rig_and_the_next_one_finds_it(tmp_path: Path, state: Path) -> None:
    first = await attach(sessions=tmp_path / "sessions", host="127.0.0.1", cameras=[CAMERA])
    try:
        assert first.started
        assert first.is_local
        again = await attach()
        assert (again.leader, again.sessions, again.started) == (first.leader, tmp_path / "sessions", False)
        named = await attach(leader=first.leader)
        assert (named.sessions, named.is_local) == (tmp_path / "sessions", True)
        # Another folder is another rig, at another port: the usual one is taken.
        other = await attach(sessions=tmp_path / "other", host="127.0.0.1")
        assert other.started
        assert other.leader.port != first.leader.port
        assert [node.name for node in (await ask_status(first.leader)).nodes] == ["webcam"]
    finally:
        await stop_all()
    await until(lambda: processes_with(str(state)) == [])


async def test_a_killed_rig_takes_its_cameras_with_it_and_is_not_listed(tmp_path: Path, state: Path) -> None:
    rig = await start_rig(sessions=tmp_path / "sessions", host="127.0.0.1", cameras=[CAMERA])
    assert processes_with(str(state)) != []
    os.kill(rig.pid, signal.SIGKILL)
    await until(lambda: list_rigs() == [])
    await until(lambda: processes_with(str(state)) == [])


async def test_a_rig_that_cannot_start_says_why(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(NetworkError, match="cannot listen on"):
            await start_rig(sessions=tmp_path, host="127.0.0.1", port=taken.getsockname()[1])
    with pytest.raises(BadInputError, match="unknown simulated camera 'nope'"):
        await start_rig(sessions=tmp_path, host="127.0.0.1", cameras=["sim:nope"])
    assert list_rigs() == []


async def test_a_leader_elsewhere_need_not_answer_yet(tmp_path: Path) -> None:
    rig = await attach(leader=Address("192.0.2.77", 4711), sessions=tmp_path)
    assert (rig.is_local, rig.started) == (False, False)


async def test_rigs_are_started_listed_and_stopped_by_commands(start: Start, tmp_path: Path) -> None:
    command = await start("rig", "start", "--host", "127.0.0.1", "--sessions", str(tmp_path / "s"), "--json")
    started = json.loads(await command.finish())
    try:
        listed = json.loads(await (await start("rig", "list", "--json")).finish())
        assert listed == {"rigs": [started]}
        assert started["sessions"] == str(tmp_path / "s")
    finally:
        command = await start("rig", "stop", "--leader", started["leader"], "--json")
        assert json.loads(await command.finish()) == {"stopped": started["leader"]}
    await until(lambda: list_rigs() == [])
    log = await asyncio.to_thread(Path(started["log"]).read_text)
    assert "stopped by an operator" in log
