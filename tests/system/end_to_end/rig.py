"""A rig of real processes: a leader, its cameras, and bursts of theirs."""

import asyncio
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from capture_app.common.errors import ExitCode
from tests.system.end_to_end.conftest import TIMEOUT_S, Command, Start
from tests.waiting import SLOW_PATIENCE_S, time_limit, until


async def lead(
    start: Start, sessions: Path, at: str = "127.0.0.1:0", options: Sequence[str] = ()
) -> tuple[Command, str]:
    """Start a leader `at` HOST:PORT, and return where it listens too."""
    host, _, port = at.rpartition(":")
    where = ("--host", host, "--port", port, "--sessions", str(sessions))
    leader = await start("leader", *where, "--json", *options)
    # What it goes on with of an earlier run may be told first.
    return leader, (await leader.next_event("listening"))["leader"]


async def join(start: Start, name: str, *leaders: str, model: str = "phone-a") -> Command:
    camera = f"sim:{model},drops=0,outliers=0"
    at = [option for leader in leaders for option in ("--leader", leader)]
    return await start("node", "--name", name, "--camera", camera, "--clock", "sim", *at)


async def join_ready(start: Start, leader: str, *names: str) -> list[Command]:
    """Start nodes, and wait until all are ready."""
    nodes = await asyncio.gather(*(join(start, name, leader) for name in names))
    await asyncio.gather(*(node.says("ready") for node in nodes))
    return nodes


async def output(command: "Command") -> str:
    printed = await command.finish()
    assert command.process.returncode == 0, command.said
    return printed


async def burst(start: Start, leader: str, *options: str) -> dict[str, Any]:
    """Take bursts until one is whole: on a starved machine a node falls silent for as long as a lost one."""
    async with time_limit(f"a whole burst ({' '.join(options)})", TIMEOUT_S):
        while True:
            command = await start("burst", "--leader", leader, "--wait-s", str(TIMEOUT_S), "--json", *options)
            printed = await command.finish()
            assert command.process.returncode in (ExitCode.OK, ExitCode.INCOMPLETE), command.said
            if command.process.returncode == ExitCode.OK:
                done: dict[str, Any] = json.loads(printed)
                return done


async def lines_of(path: Path, least: int) -> None:
    """Wait until a journal lists so many images."""
    await until(lambda: path.exists() and path.read_bytes().count(b"\n") >= least, seconds=SLOW_PATIENCE_S)
