"""A rig with nodes below a relay, as processes: one session in the root's time; a relay that is killed."""

import asyncio
from pathlib import Path
from typing import Any

from capture_app.common.address import parse_address
from capture_app.common.errors import ExitCode
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.status import BurstStatus, NodeStatus
from capture_app.rig.rig_link import RigLink, ask_status
from capture_app.session.format.manifest import JOURNAL
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.rig import join, lead, lines_of, output
from tests.waiting import until

from .conftest import TIMEOUT_S, Command, Start

LOST_TIME_NS = 1_000_000_000
"""A synchronized clock is never off by so much, however busy the machine; others here are, by hours."""


async def ask(address: str, **wanted: Any) -> BurstStatus:
    """Order bursts, without a process of their own, until one is whole, and return how it ended.

    On a starved machine a node falls silent for as long as a lost one, and the first is not whole.
    """
    request = BurstRequest(wait_ready_s=TIMEOUT_S, **wanted)
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            done = [status async for status in RigLink(parse_address(address)).burst(request)][-1]
            if done.received == done.expected:
                return done


async def nodes_at(address: str) -> dict[str, NodeStatus]:
    return {node.name: node for node in (await ask_status(parse_address(address))).nodes}


async def relay(start: Start, name: str, *parents: str, at: str = "127.0.0.1:0") -> tuple[Command, str]:
    host, _, port = at.rpartition(":")
    options = ("--name", name, "--host", host, "--port", port, "--clock", "sim", "--json")
    command = await start("relay", *parents, *options)
    return command, (await command.next_json())["relay"]


def check(folder: str | None, cameras: int, frames: int) -> None:
    """Every image is there, in the root's time, which is the host's, as far as its hard bound says."""
    assert folder is not None
    session = Session.open(Path(folder))
    assert verify(session) == []
    manifest, truth = session.manifest, session.true_times()
    assert truth is not None
    assert (len(manifest.cameras), len(manifest.images)) == (cameras, cameras * frames)
    for image in manifest.images:
        local = truth.clocks[image.camera]
        assert image.local_ns is not None
        assert image.hard_bound_ns is not None
        error_ns = abs(image.leader_ns - local.true_from_local(image.local_ns))
        assert error_ns <= image.hard_bound_ns
        assert error_ns < LOST_TIME_NS


async def test_nodes_below_a_relay_are_part_of_the_rig_even_when_it_is_killed(
    start: Start, tmp_path: Path
) -> None:
    leader, root = await lead(start, tmp_path / "sessions")
    relaying, between = await relay(start, "hall", root)
    await asyncio.gather(
        join(start, "near", root), join(start, "far1", between, root), join(start, "far2", between, root)
    )
    await relaying.says(f"joined {root}")
    # The relay is asked as a leader is.
    done = await ask(between, nodes=3, frames=5)
    assert (done.received, done.expected) == (15, 15)
    check(done.session, cameras=3, frames=5)
    seen = await nodes_at(root)
    assert {name: (node.parent, node.depth) for name, node in seen.items()} == {
        "far1": ("hall", 2),
        "far2": ("hall", 2),
        "hall": (None, 1),
        "near": (None, 1),
    }
    # What the relay cannot know, its nodes cannot either; but each tells of its own moment, and bounds grow
    # by the age of the newest message.
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            bounds = [seen[name].hard_bound_ns or 0 for name in ("hall", "far1", "far2")]
            if 0 < bounds[0] < min(bounds[1:]):
                break
            await asyncio.sleep(0.2)
            seen = await nodes_at(root)
    table = await output(await start("status", "--leader", between))
    assert "\nhall " in table
    assert "\n  far1 " in table

    asking = asyncio.create_task(ask(root, frames=8))
    await until(lambda: sorted((tmp_path / "sessions").iterdir())[-1].name > Path(done.session or "").name)
    await lines_of(sorted((tmp_path / "sessions").iterdir())[-1] / JOURNAL, 4)
    await relaying.kill()
    done = await asking
    assert (done.received, done.expected) == (24, 24)
    check(done.session, cameras=3, frames=8)
    # Images that had all arrived before the relay died do not wait for its nodes to come.
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            if (await nodes_at(root))["far1"].parent is None:
                break
            await asyncio.sleep(0.2)

    _, between = await relay(start, "hall", root, at=between)
    await leader.says("hall is back")
    await join(start, "new", between)
    done = await ask(root, nodes=4, frames=1)
    check(done.session, cameras=4, frames=1)


async def test_a_relay_without_a_leader_holds_the_time_and_says_so(start: Start, tmp_path: Path) -> None:
    leader, root = await lead(start, tmp_path / "sessions")
    relaying, between = await relay(start, "hall", root)
    node = await join(start, "far", between)
    await node.says("ready")
    await leader.kill()
    await relaying.says(f"lost {root} (the leader is silent): in holdover")
    alone = await ask_status(parse_address(between))
    assert (alone.relay, [node.name for node in alone.nodes]) == ("hall", ["far"]), (
        "who lost one keeps the other"
    )
    assert "lost its leader" in alone.message
    refused = await start("burst", "--leader", between)
    assert await refused.finish() == ""
    assert refused.process.returncode == ExitCode.NETWORK
    assert "relay hall lost its leader" in refused.said[-1]

    leader, _ = await lead(start, tmp_path / "sessions", root)
    await leader.says("far joined")
    done = await ask(root, frames=2)
    check(done.session, cameras=1, frames=2)


async def test_a_name_is_unique_in_the_whole_tree(start: Start, tmp_path: Path) -> None:
    leader, root = await lead(start, tmp_path / "sessions")
    _, between = await relay(start, "hall", root)
    await join(start, "cam", root)
    await leader.says("cam joined")
    other = await start("node", "--name", "cam", "--camera", "sim:phone-a", "--leader", between,
                        "--spool", str(tmp_path / "other"))  # fmt: skip
    await other.says("join-refused: another camera named cam is here")
