"""A leader whose address changes for good within a recording: nodes that found it find it again."""

import asyncio
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.unit.net.machines import LEADER_HOST, Machine, two_machines
from tests.waiting import SLOW_PATIENCE_S, until

SECONDS, NEW_HOST = 12, "10.77.0.9"


@contextmanager
def running(machine: Machine, folder: Path, name: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run `capture-app` on a machine with a folder of its own; what it prints goes to `name`.log."""
    own = {"XDG_DATA_HOME": folder / machine.name, "XDG_STATE_HOME": folder / machine.name}
    with (folder / f"{name}.log").open("wb") as log:
        command = subprocess.Popen(
            machine.command(sys.executable, "-m", "capture_app.cli", *words),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env={**os.environ, **{key: str(path) for key, path in own.items()}, "SIMULSHOT_OPEN": "1"},
        )
        try:
            yield command
        finally:
            command.terminate()
            command.wait()


async def test_a_recording_goes_on_at_the_new_address_of_its_leader(tmp_path: Path) -> None:
    def says(name: str, words: str) -> bool:
        return words in (tmp_path / f"{name}.log").read_text()

    sessions = str(tmp_path / "sessions")
    with two_machines() as (leader, node), ExitStack() as processes:
        processes.enter_context(running(leader, tmp_path, "leader", "leader", "--sessions", sessions))
        await until(lambda: says("leader", "leader at"), seconds=SLOW_PATIENCE_S)
        for name in ("cam0", "cam1"):
            camera = ("--name", name, "--camera", "sim:phone-a,drops=0,outliers=0", "--clock", "sim")
            processes.enter_context(running(node, tmp_path, name, "node", *camera))
        await until(lambda: says("cam0", "ready") and says("cam1", "ready"), seconds=SLOW_PATIENCE_S)
        order = ("record", "--leader", "127.0.0.1", "--seconds", str(SECONDS), "--wait-s", "20", "--json")
        record = processes.enter_context(running(leader, tmp_path, "record", *order, "--min-nodes", "2"))
        await until(lambda: says("leader", "burst 1: 1"), seconds=SLOW_PATIENCE_S)
        leader.ip("address", "del", f"{LEADER_HOST}/24", "dev", "cable")
        leader.ip("address", "add", f"{NEW_HOST}/24", "dev", "cable")
        ended = await asyncio.wait_for(asyncio.to_thread(record.wait), SLOW_PATIENCE_S)
        said = "\n".join(
            (tmp_path / f"{name}.log").read_text() for name in ("leader", "cam0", "cam1", "record")
        )
    assert ended == 0, said
    assert f"the leader at {LEADER_HOST}:47010 is now at {NEW_HOST}:47010" in said
    assert "firewall" not in said
