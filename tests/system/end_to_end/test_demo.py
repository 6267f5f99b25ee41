"""The demo's parts with the cheap test card; scene and comparison have tests of their own."""

import asyncio
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from capture_app.commands.demo import capture, measure_sync_errors
from capture_app.common.child import ask_reconstruct
from capture_app.common.errors import ExitCode, SimulshotError
from capture_app.common.stagger import Stagger
from capture_app.session.files.durable import free_name
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.processes import children_of, is_running

from .conftest import TIMEOUT_S

PARENT = """
import asyncio, signal, sys
from contextlib import aclosing
from pathlib import Path
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.orders import AddSimulated

async def main():
    options = LeaderOptions(sessions=Path("unused"), host="127.0.0.1", port=0)
    async with await LeaderNode.start(options) as leader:
        async with aclosing(LocalNodes(leader.own_address, Path(sys.argv[1]), leader.log)) as nodes:
            await nodes.add_simulated(AddSimulated(cameras=2, scene="bars"))
            while [node.state for node in leader.status().nodes] != ["ready", "ready"]:
                await asyncio.sleep(0.05)
            print("ready", flush=True)
            await asyncio.Event().wait()

# A script that starts these tests with & has them ignore SIGINT, and so their children.
signal.signal(signal.SIGINT, signal.default_int_handler)
asyncio.run(main())
"""


async def test_a_burst_of_simulated_nodes_is_held_against_the_truth(tmp_path: Path) -> None:
    said: list[str] = []
    session = await capture(tmp_path, 2, said.append, scene="bars")
    assert verify(session) == []
    assert len(session.manifest.images) == 10
    assert said[-1] == "[10/10] images saved" or "missing" in said[-1]
    nodes = measure_sync_errors(session)
    assert [node["name"] for node in nodes] == ["cam00", "cam01"]
    for node in nodes:
        assert abs(node["clock_error_ns"]) <= node["hard_bound_ns"]
        assert abs(node["total_error_ns"]) < session.manifest.burst.period_ns // 2


async def test_a_staggered_burst_is_held_against_its_plan(tmp_path: Path) -> None:
    session = await capture(tmp_path, 2, lambda _: None, scene="bars", stagger=Stagger())
    delays_ns = [session.camera(name).delay_ns for name in ("cam00", "cam01")]
    assert delays_ns == [0, pytest.approx(session.manifest.burst.period_ns / 2, abs=1)]
    for node in measure_sync_errors(session):
        assert abs(node["total_error_ns"]) < delays_ns[1] // 2
        assert abs(node["phase_error_ns"]) < delays_ns[1] // 2


async def test_a_node_that_cannot_start_ends_the_demo_with_its_own_words(tmp_path: Path) -> None:
    with pytest.raises(SimulshotError, match="nonsense") as caught:
        await capture(tmp_path, 2, lambda _: None, scene="nonsense")
    assert caught.value.exit_code == ExitCode.BAD_INPUT
    assert not (tmp_path / "burst-001").exists(), "nothing half-written"


async def test_a_comparison_that_fails_ends_with_its_own_words(tmp_path: Path) -> None:
    with pytest.raises(SimulshotError, match="nowhere") as caught:
        await ask_reconstruct(
            ["compare", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")], dict[str, Any]
        )
    assert caught.value.exit_code == ExitCode.BAD_INPUT


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
async def test_nodes_end_with_the_process_that_started_them(how: signal.Signals, tmp_path: Path) -> None:
    parent = await asyncio.create_subprocess_exec(
        sys.executable,
        "-c",
        PARENT,
        str(tmp_path),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    assert parent.stdout is not None
    async with asyncio.timeout(TIMEOUT_S):
        assert await parent.stdout.readline() == b"ready\n"
        pids = children_of(parent.pid)
        assert len(pids) == 2
        assert all(is_running(pid) for pid in pids)
        parent.send_signal(how)
        await parent.stdout.read()
        await parent.wait()
        while any(is_running(pid) for pid in pids):  # noqa: ASYNC110 - they are not our children
            await asyncio.sleep(0.05)


def test_folders_are_never_used_twice(tmp_path: Path) -> None:
    for expected in ("compare", "compare-2", "compare-3"):
        folder = free_name(tmp_path / "compare")
        assert folder.name == expected
        folder.mkdir()
