"""Settings are the rig's: whoever joins later or comes back has them too, and the take's record says so."""

import asyncio
import json
from pathlib import Path
from typing import Any

from capture_app.common.camera_facts import Control
from tests.system.end_to_end.rig import lead, output
from tests.system.end_to_end.test_recording import take
from tests.waiting import SLOW_PATIENCE_S

from .conftest import Command, Start

CAMERA = "sim:phone-a,drops=0,outliers=0,scale=0.1"


async def node(start: Start, name: str, address: str) -> Command:
    started = await start("node", "--name", name, "--camera", CAMERA, "--clock", "sim", "--leader", address)
    await started.says("ready")
    return started


async def held(start: Start, address: str) -> dict[str, dict[str, Any]]:
    printed = json.loads(await output(await start("cameras", "controls", "--leader", address, "--json")))
    return {
        one["camera"]: {of["control"]: of["value"] for of in one["state"].get("controls", ())}
        for one in printed["cameras"]
    }


async def test_who_joins_or_restarts_is_like_the_others(start: Start, tmp_path: Path) -> None:
    _, address = await lead(start, tmp_path / "sessions")
    nodes = {name: await node(start, name, address) for name in "abc"}
    wanted = {"exposure": 4000.0, "gain": 2.0, "white-balance": 4300.0}
    values = [f"{control}={value:g}" for control, value in wanted.items()]
    await output(await start("cameras", "set", *values, "--leader", address))
    alike = (await held(start, address))["a"]
    assert alike["white-balance"] == 4300.0

    await nodes["a"].kill()
    nodes["a"] = await node(start, "a", address)
    nodes["d"] = await node(start, "d", address)
    async with asyncio.timeout(SLOW_PATIENCE_S):
        while await held(start, address) != dict.fromkeys("abcd", alike):
            pass
    session = await take(start, "burst", "--leader", address)
    for camera in session.manifest.cameras:
        assert camera.held == {Control(name): value for name, value in wanted.items()}

    profile = tmp_path / "night.json"
    await output(await start("cameras", "controls", "--save", str(profile), "--leader", address))
    await output(await start("cameras", "set", "gain=3", "white-balance=auto", "--leader", address))
    assert (await held(start, address))["d"]["gain"] == 3.0
    await output(await start("cameras", "set", "--profile", str(profile), "--leader", address))
    assert await held(start, address) == dict.fromkeys("abcd", alike)
