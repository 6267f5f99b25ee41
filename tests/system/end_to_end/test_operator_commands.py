"""What the screen can do, done by commands: cameras started, looked at, shown in detail and removed."""

import asyncio
import json
import os
import sys
from asyncio.subprocess import DEVNULL, PIPE
from pathlib import Path
from typing import Any

import cv2

from capture_app.common.errors import ExitCode
from tests.system.end_to_end.rig import burst

from .conftest import Start

CAMERA = "sim:webcam,scale=0.1"


async def test_a_camera_is_started_looked_at_and_removed(start: Start, tmp_path: Path) -> None:
    leader = await start(
        "leader", "--host", "127.0.0.1", "--port", "0", "--sessions", str(tmp_path), "--json"
    )
    at = ("--leader", (await leader.next_json())["leader"])

    async def result(*arguments: str) -> Any:
        command = await start(*arguments, *at, "--json")
        printed = await command.finish()
        assert command.process.returncode == 0, command.said
        return json.loads(printed)

    async def refusal(code: ExitCode, *arguments: str) -> str:
        command = await start(*arguments, *at)
        assert await command.finish() == ""
        assert command.process.returncode == code, command.said
        return command.said[-1]

    watching = await start("status", *at, "--watch", "--json")
    assert (await watching.next_json())["rig"]["nodes"] == []
    assert await result("cameras", "add", CAMERA, "--name", "desk") == {"added": ["desk"]}
    assert await result("cameras", "add", "--simulated", "1", "--scene", "bars") == {"added": ["cam00"]}
    assert "already exists" in await refusal(ExitCode.BAD_INPUT, "cameras", "add", CAMERA, "--name", "desk")
    assert "'moon'" in await refusal(
        ExitCode.BAD_INPUT, "cameras", "add", "--simulated", "2", "--scene", "moon"
    )

    picture = tmp_path / "desk.jpg"
    seen = await result("preview", "desk", "--out", str(picture), "--width", "32", "--wait-s", "200")
    assert (seen["camera"], seen["width"], seen["height"]) == ("desk", 32, 24)
    assert cv2.imread(str(picture)).shape == (24, 32, 3)
    there = await refusal(ExitCode.INCOMPLETE, "preview", "door")
    assert "no camera named door (cameras: cam00, desk)" in there
    deep = await refusal(ExitCode.INCOMPLETE, "preview", "desk", "--depth", "--wait-s", "200")
    assert "the rig is not calibrated" in deep

    counting = await start("coverage", *at, "--for-s", "3", "--json")
    covered = json.loads((await counting.finish()).splitlines()[-1])
    assert counting.process.returncode == ExitCode.INCOMPLETE
    assert {name: camera["views"] for name, camera in covered["cameras"].items()} == {"cam00": 0, "desk": 0}
    assert "the coverage is incomplete: " in counting.said[-1]
    assert "has not seen the board yet" in counting.said[-1]

    events = [await watching.next_json()]
    while events[-1].get("text") != "desk joined":
        events.append(await watching.next_json())
    assert (events[-1]["event"], events[-1]["camera"]) == ("log", "desk")
    assert await watching.stop() == 130
    assert "burst 7 is not under way" in await refusal(ExitCode.BAD_INPUT, "burst", "--cancel", "7")

    detail = await result("cameras", "show", "desk")
    assert detail["camera"] == "desk"
    assert detail["samples"], "it has exchanged messages with the leader"
    assert "joining" in detail["log"][0]["text"]

    assert await result("cameras", "remove", "desk") == {"removed": "desk"}
    assert [node["name"] for node in (await result("status"))["nodes"]] == ["cam00"]
    assert "no node named desk" in await refusal(ExitCode.BAD_INPUT, "cameras", "remove", "desk")
    assert await result("rig", "stop") == {"stopped": at[1]}
    await leader.finish()
    assert leader.process.returncode == 0


async def test_a_rig_goes_on_when_nobody_reads_its_events_any_more(start: Start, tmp_path: Path) -> None:
    nobody, writing = os.pipe()
    leading = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "capture_app.cli", "leader", "--host", "127.0.0.1", "--port", "0", "--json"),
        *("--sessions", str(tmp_path), "--camera", CAMERA),
        stdin=DEVNULL,
        stdout=writing,
        stderr=PIPE,
        env={**os.environ, "XDG_STATE_HOME": str(tmp_path / "state")},
    )
    os.close(writing)
    with os.fdopen(nobody) as events:
        at = json.loads(events.readline())["leader"]
    assert (await burst(start, at, "--frames", "2", "--min-nodes", "1"))["received"] == 2
    leading.terminate()
    _, said = await leading.communicate()
    assert leading.returncode == ExitCode.INTERRUPTED, said
    assert b"Traceback" not in said


async def test_a_count_of_the_board_goes_on_when_the_leader_is_back(start: Start, tmp_path: Path) -> None:
    serving = "leader", "--host", "127.0.0.1", "--sessions", str(tmp_path), "--json"
    leader = await start(*serving, "--port", "0")
    address = (await leader.next_json())["leader"]
    watching = await start("status", "--leader", address, "--watch", "--json")
    await start("node", "--name", "cam00", "--camera", "sim:phone-a,scene=board", "--leader", address)
    while (await watching.next_json()).get("text") != "cam00 joined":
        pass

    counting = await start("coverage", "--leader", address, "--json")
    assert (await counting.next_json())["cameras"]["cam00"]["views"] == 0
    await leader.kill()
    await counting.says("the count so far is kept")
    await start(*serving, "--port", address.rpartition(":")[2])
    await counting.says("the count continues")
    # The previews come again too: at 3 a second so many cannot be of before.
    while (await counting.next_json())["cameras"]["cam00"]["views"] < 4:
        pass
    assert await counting.stop() == 130
