"""Machines that do not know each other, as processes with folders of their own: a rig by one code."""

import json
from pathlib import Path

import pytest

from capture_app.common.errors import ExitCode
from tests.system.end_to_end.rig import burst, output

from .conftest import Start


async def test_a_strange_machine_is_told_what_to_do_and_joins_for_good_by_a_code(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def on(machine: str) -> None:
        monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / machine))

    on("leader")
    leader = await start(
        "leader", "--host", "127.0.0.1", "--port", "0", "--sessions", str(tmp_path / "s"), "--json"
    )
    address = (await leader.next_json())["leader"]
    options = (
        "--name",
        "cam0",
        "--camera",
        "sim:phone-a",
        "--clock",
        "sim",
        "--spool",
        str(tmp_path / "spool"),
    )
    node = ("node", "--leader", address, *options)

    on("garage")
    alone = await start(*node)
    assert f"capture-app trust pair {address} --code CODE" in await alone.says("does not know the leader")

    on("leader")
    invited = json.loads(await output(await start("trust", "invite", "--leader", address, "--json")))
    on("garage")
    paired = await start("trust", "pair", address, "--code", invited["code"])
    await paired.finish()
    assert paired.process.returncode == ExitCode.OK
    await alone.says("ready")
    await alone.kill()
    again = await start(*node)  # nothing more is asked
    await again.says("ready")

    on("leader")
    taken = await burst(start, address, "--min-nodes", "1", "--frames", "2")
    assert (taken["received"], taken["expected"]) == (2, 2)
    on("garage")
    status = await start("status", "--leader", address)
    assert "known here as camera, not as operator" in await status.says("error")
