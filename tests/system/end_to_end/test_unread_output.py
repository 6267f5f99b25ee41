"""A leader whose stdout and stderr are pipes that nobody reads takes burst after burst."""

import asyncio
import json
import os
import subprocess
import sys
from pathlib import Path

from capture_app.common.address import Address
from capture_app.protocol.messages import BurstRequest
from capture_app.rig.rig_link import RigLink
from tests.project import ROOT

BURSTS = 200
CAMERA = "sim:phone-a,scene=bars,drops=0,outliers=0"


async def burst(leader: Address, wait_s: float = 0.0) -> int:
    """Take a burst of one frame, and return how many have come of it."""
    said = [status async for status in RigLink(leader).burst(BurstRequest(frames=1, wait_ready_s=wait_s))]
    return said[-1].received


async def test_a_leader_into_pipes_that_nobody_reads_takes_200_bursts(tmp_path: Path) -> None:
    process = subprocess.Popen(  # noqa: ASYNC220 - its pipes must not be read here
        [
            sys.executable, "-m", "capture_app.cli", "leader", "--json", "--host", "127.0.0.1", "--port", "0",
            "--sessions", str(tmp_path / "sessions"), "--spool", str(tmp_path / "spool"), "--camera", CAMERA,
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(tmp_path / "state")},
    )  # fmt: skip
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        port = json.loads(process.stdout.readline())["port"]
        leader = Address("127.0.0.1", port)
        taken = await burst(leader, wait_s=60.0)
        while taken < BURSTS:
            taken += sum(await asyncio.gather(*(burst(leader) for _ in range(min(10, BURSTS - taken)))))
        assert taken == BURSTS
        process.terminate()
        printed, _ = process.communicate(timeout=60)
        assert process.returncode == 130
        told = [json.loads(line) for line in printed.splitlines()]
        assert sum(line["lines"] for line in told if line["event"] == "left-out") > 0
    finally:
        process.kill()
        process.communicate()
    assert len(list((tmp_path / "sessions").glob("*/session.json"))) == BURSTS
