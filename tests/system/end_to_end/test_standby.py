"""Two ranked leaders as processes: one is killed, the other leads in its time, and back again."""

import asyncio
import signal
import socket
from contextlib import suppress
from pathlib import Path

from capture_app.common.address import parse_address
from capture_app.common.errors import ExitCode, SimulshotError
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.status import BurstStatus
from capture_app.rig.rig_link import RigLink
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.rig import join

from .conftest import TIMEOUT_S, Command, Start

CAMERAS = 3
TAKE_OVER_NS = 50_000_000
"""Both have this machine's clock, and cameras are hours off: what is taken over is the same time."""


def free_addresses(count: int) -> list[str]:
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    addresses = [f"127.0.0.1:{one.getsockname()[1]}" for one in sockets]
    for one in sockets:
        one.close()
    return addresses


async def ranked(start: Start, at: str, leaders: list[str], sessions: Path) -> Command:
    host, _, port = at.rpartition(":")
    named = [option for leader in leaders for option in ("--leader", leader)]
    return await start(
        "leader", "--host", host, "--port", port, "--sessions", str(sessions), "--json", *named
    )


async def take(leaders: list[str]) -> BurstStatus:
    """Take bursts of whoever leads until one is whole: on a starved machine one that lives seems gone."""
    request = BurstRequest(frames=3, wait_ready_s=TIMEOUT_S, nodes=CAMERAS)
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            for leader in leaders:
                with suppress(SimulshotError):
                    done = [status async for status in RigLink(parse_address(leader)).burst(request)][-1]
                    if done.received == done.expected == 3 * CAMERAS:
                        return done
            await asyncio.sleep(0.2)


def check(done: BurstStatus) -> None:
    """The burst is complete, and every error bar holds: the rig's time is this machine's."""
    assert done.session is not None
    session = Session.open(Path(done.session))
    assert verify(session) == []
    truth = session.true_times()
    assert truth is not None
    for image in session.manifest.images:
        assert image.local_ns is not None
        assert image.hard_bound_ns is not None
        error_ns = abs(image.leader_ns - truth.clocks[image.camera].true_from_local(image.local_ns))
        assert error_ns <= image.hard_bound_ns + TAKE_OVER_NS


async def test_a_standby_leads_when_the_leader_is_killed_and_the_other_way_round(
    start: Start, tmp_path: Path
) -> None:
    first, second = addresses = free_addresses(2)
    leading = await ranked(start, first, addresses, tmp_path / "a")
    assert (await leading.next_json())["leader"] == first
    standing_by = await ranked(start, second, addresses, tmp_path / "b")
    await standing_by.says(f"{first} leads")
    await asyncio.gather(*(join(start, f"cam{i}", *addresses) for i in range(CAMERAS)))
    check(await take(addresses))

    await leading.kill()
    assert (await standing_by.next_json())["leader"] == second
    # How soon all are back is measured by `python -m benchmarks.endurance.standby`.
    check(await take(addresses))

    returned = await ranked(start, first, addresses, tmp_path / "a")
    await returned.says(f"{second} leads")
    check(await take(addresses))
    await standing_by.kill()
    assert (await returned.next_json())["leader"] == first
    check(await take(addresses))


async def test_a_leader_that_was_frozen_follows_the_one_that_took_over(start: Start, tmp_path: Path) -> None:
    first, second = addresses = free_addresses(2)
    leading = await ranked(start, first, addresses, tmp_path / "a")
    assert (await leading.next_json())["leader"] == first
    standing_by = await ranked(start, second, addresses, tmp_path / "b")
    await standing_by.says(f"{first} leads")
    await asyncio.gather(*(join(start, f"cam{i}", *addresses) for i in range(CAMERAS)))
    check(await take(addresses))

    leading.process.send_signal(signal.SIGSTOP)
    assert (await standing_by.next_json())["leader"] == second
    check(await take([second]))
    leading.process.send_signal(signal.SIGCONT)
    await leading.says(f"{second} leads")
    check(await take([second]))


async def test_a_leader_that_is_not_among_those_named_says_so(start: Start, tmp_path: Path) -> None:
    leader = await ranked(start, "127.0.0.1:47999", ["192.0.2.1:47010", "192.0.2.2:47010"], tmp_path)
    await leader.says("give each of them the same list of all leaders, preferred first")
    await leader.finish()
    assert leader.process.returncode == ExitCode.BAD_INPUT
