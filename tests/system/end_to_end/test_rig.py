"""A leader and nodes as processes: join, burst, session, loss, return, a leader that comes back."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.address import parse_address
from capture_app.common.errors import ExitCode
from capture_app.common.node_state import NodeState
from capture_app.node.camera.device_profiles import FILE
from capture_app.rig.rig_link import ask_status
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.rig import burst, join, join_ready, lead, output
from tests.waiting import time_limit

from .conftest import Start


async def states(leader: str) -> dict[str, NodeState]:
    return {node.name: node.state for node in (await ask_status(parse_address(leader))).nodes}


def number(done: dict[str, Any]) -> int:
    """The number in the name of a burst's session."""
    return int(Path(done["session"]).name.removeprefix("burst-"))


async def test_a_rig_started_by_hand_takes_a_burst_and_survives_a_node(start: Start, tmp_path: Path) -> None:
    leader, address = await lead(start, tmp_path / "sessions")
    nodes = await asyncio.gather(join(start, "a", address), join(start, "b", address, model="phone-b"))
    await asyncio.gather(leader.says("a joined"), leader.says("b joined"))

    done = await burst(start, address, "--frames", "3", "--spacing", "2")
    first = number(done)
    session = Session.open(Path(done["session"]))
    assert verify(session) == []
    assert len(session.manifest.images) == 6
    assert session.manifest.origin == "simulated"
    one, two, three = session.manifest.burst.instants_ns
    assert two - one == three - two == 2 * session.manifest.burst.period_ns
    for camera in session.manifest.cameras:
        assert camera.clock is not None
        assert abs(camera.clock.offset_ns) > 3600 * 10**9, "its clock is hours off"
    for image in session.manifest.images:
        assert abs(image.residual_ns) < session.manifest.burst.period_ns // 2

    await nodes[0].kill()
    # On a busy machine it may have been lost, and back, before.
    async with time_limit("the loss of a"):
        while (await states(address))["a"] != NodeState.LOST:  # noqa: ASYNC110
            await asyncio.sleep(0.1)
    await leader.says("lost a: silent")

    again = await join(start, "a", address)
    await leader.says("a is back")
    await again.says("ready")
    done = await burst(start, address, "--frames", "1")
    assert number(done) > first
    assert (done["received"], done["expected"]) == (2, 2)

    assert await nodes[1].stop() == 130
    await leader.says("lost b: it left")
    assert await leader.stop() == 130


async def test_nodes_wait_for_a_leader_and_come_back_to_another_run_of_it(
    start: Start, tmp_path: Path
) -> None:
    leader, address = await lead(start, tmp_path / "sessions")
    (node,) = await join_ready(start, address, "a")
    first = await burst(start, address, "--frames", "1")
    assert first["received"] == 1

    await leader.kill()
    await node.says("leader-lost")
    heard = len(node.said)
    leader, _ = await lead(start, tmp_path / "sessions", address)
    await leader.says("a joined")
    await node.says("ready", after=heard)
    done = await burst(start, address, "--frames", "2")
    assert done["received"] == 2
    assert number(done) > number(first)
    assert done["burst"] == number(done), "its number is its session's, in whichever run of the leader"


async def test_a_node_that_dies_in_a_burst_leaves_a_session_that_says_so(
    start: Start, tmp_path: Path
) -> None:
    leader, address = await lead(start, tmp_path / "sessions")
    nodes = await join_ready(start, address, "a", "b")
    command = await start("burst", "--leader", address, "--frames", "30", "--json")
    await leader.says("burst 1: 0 of 60")
    await nodes[1].kill()
    printed = await command.finish()
    assert command.process.returncode == ExitCode.INCOMPLETE, command.said
    assert "is incomplete" in command.said[-1]
    done = json.loads(printed)
    session = Session.open(Path(done["session"]))
    assert len(session.manifest.images) == 30
    assert {gap.camera for gap in session.manifest.missing} == {"b"}
    assert verify(session) == []


async def test_a_camera_that_goes_away_is_told_to_the_leader(start: Start, tmp_path: Path) -> None:
    _, address = await lead(start, tmp_path / "sessions")
    camera = "sim:phone-a,fail_after_s=1"
    node = await start("node", "--name", "a", "--camera", camera, "--leader", address)
    await node.says("failed: ")
    seen = await states(address)
    assert seen["a"] in {NodeState.FAILED, NodeState.SYNCING, NodeState.ALIGNING}
    await node.says("camera is back")


async def test_a_leader_with_a_camera_of_its_own(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    leader, address = await lead(start, tmp_path, options=("--camera", "sim:perfect", "--fps", "30"))
    await leader.says("perfect joined")
    done = await burst(start, address, "--frames", "1")
    assert done["received"] == 1
    assert (tmp_path / "data/simulshot" / FILE).is_file(), "what its long frames did is known on the next use"


async def test_a_sequence_of_named_takes(start: Start, tmp_path: Path) -> None:
    _, address = await lead(start, tmp_path / "sessions")
    await join_ready(start, address, "a")
    takes = ("--frames", "3", "--before", "2", "--name", "jump", "--repeat", "3")
    for every in ((), ("--every", "0.2")):
        command = await start("burst", "--leader", address, *takes, *every, "--json")
        bursts = json.loads(await output(command))["bursts"]
        assert [done["received"] for done in bursts] == [3, 3, 3]
        assert all(Path(done["session"]).name.startswith("jump-00") for done in bursts)
    assert len(list((tmp_path / "sessions").glob("jump-*"))) == 6


async def test_a_burst_that_nobody_can_take_is_one_line_and_no_session(start: Start, tmp_path: Path) -> None:
    leader, address = await lead(start, tmp_path / "sessions")
    for options, says in (
        ((), "no camera is here (start one with: capture-app node --leader"),
        (("--wait-s", "0.2", "--min-nodes", "3"), "not ready after 0.2 s: 0 of 3 nodes have joined"),
    ):
        command = await start("burst", "--leader", address, *options)
        assert await command.finish() == ""
        assert command.process.returncode == ExitCode.INCOMPLETE
        assert says in command.said[-1]
        assert command.said[-1].startswith("capture-app: error: ")
    assert not any("Traceback" in line for line in leader.said)
    assert not (tmp_path / "sessions").exists()


async def test_several_cameras_of_a_machine_run_in_one_process(start: Start, tmp_path: Path) -> None:
    leader, address = await lead(start, tmp_path / "sessions")
    specs = ("sim:phone-a,drops=0,outliers=0", "sim:phone-b,drops=0,outliers=0", "v4l2:/dev/none")
    cameras = [word for spec in specs for word in ("--camera", spec)]
    node = await start("node", "--name", "host", *cameras, "--clock", "sim", "--leader", address)
    await asyncio.gather(leader.says("host-phone-a joined"), leader.says("host-phone-b joined"))
    await node.says("host-none: there is no camera /dev/none")
    done = await burst(start, address, "--frames", "2")
    session = Session.open(Path(done["session"]))
    assert {camera.name for camera in session.manifest.cameras} == {"host-phone-a", "host-phone-b"}
    assert await node.stop() == 130
    twice = await start("node", "--camera", specs[2], "--camera", specs[2], "--leader", address)
    assert "given twice" in await twice.says("error")
