"""What the terminal UI costs, and whether a rig notices it: 20 cameras, with previews and without a screen.

A leader and simulated cameras (small test cards), each a process of this machine. Bursts are taken in turns
without and with a screen, in a pseudo-terminal of 120x40, that shows the phases of all cameras, then their
previews. Then a leader that tells the same status of 20 cameras for ever has a screen that should do nothing.
Reports processor time of the screen, bytes to the terminal, updates a second, and for both conditions drops,
missing and late images, the time from the key to the first instant, and how far images are from it. All
figures are of simulated cameras on loopback. `--quick` takes one turn.
"""

import asyncio
import os
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

from benchmarks.report import Report, new_parser, print_report, print_table, talk
from benchmarks.screen.screen_process import ScreenProcess, processor_s
from capture_app.common.address import Address
from capture_app.net.channel import Channel
from capture_app.net.server import TransferServer, bind_port
from capture_app.node.leader.viewfinders import Viewfinders
from capture_app.node.leader.watchers import RigState, Watcher
from capture_app.protocol.messages import BurstRequest, StatusAnswer, StatusRequest, ToLeader
from capture_app.protocol.news import Log
from capture_app.protocol.orders import StopRig
from capture_app.protocol.status import RigStatus
from capture_app.rig.link import RigLink, ask_burst, ask_status, give_order
from capture_app.rig.process import start_rig
from capture_app.session.reading.reader import Session

READY_S = 240.0
SETTLE_S = 6.0
BURST_EVERY_S = 3.0
FRAMES = 5
PREVIEWS_KEY, PHASES_KEY = "2", "1"
MOST_UI_CORES, MOST_IDLE_CORES, MOST_IDLE_BYTES = 0.5, 0.03, 1000.0


@dataclass(slots=True)
class Condition:
    """What was measured in all turns of one condition."""

    name: str
    seconds: float = 0.0
    bursts: int = 0
    images: int = 0
    drops: int = 0
    missing: int = 0
    late: int = 0
    key_to_first_ms: list[float] = field(default_factory=list)
    residuals_us: list[float] = field(default_factory=list)
    screen_s: float = 0.0
    rig_s: float = 0.0
    """Processor time of the leader and the cameras."""
    drawn_bytes: int = 0
    updates: int = 0


def main() -> int:
    """Measure and report; 1 where a target is missed."""
    options = _options()
    with TemporaryDirectory(prefix="simulshot-tui-") as folder:
        environment = {
            name: f"{folder}/{name.lower()}"
            for name in ("XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_CACHE_HOME")
        }
        os.environ |= environment
        conditions, idle = asyncio.run(_measure(Path(folder), options, environment))
    return _report(options, conditions, idle)


async def _measure(
    folder: Path, options: Namespace, environment: dict[str, str]
) -> tuple[list[Condition], Condition]:
    conditions = without, phases, previews = [Condition(name) for name in ("none", "phases", "previews")]
    rig = await start_rig(sessions=folder / "sessions", host="127.0.0.1")
    at = rig.address
    cameras = [_start_camera(number, at, folder) for number in range(options.cameras)]
    pids = (rig.pid, *(camera.pid for camera in cameras))
    try:
        talk(f"{options.cameras} cameras are starting")
        await _take_burst(Condition("first"), at, wait_ready_s=READY_S, nodes=options.cameras)
        for turn in range(options.turns):
            talk(f"turn {turn + 1} of {options.turns}")
            await _run(without, at, pids, options.seconds, None)
            with ScreenProcess("--leader", str(at), environment=environment) as screen:
                await asyncio.to_thread(screen.wait_until_drawn)
                for condition, key in ((phases, PHASES_KEY), (previews, PREVIEWS_KEY)):
                    screen.press(key)
                    await asyncio.sleep(SETTLE_S)
                    await _run(condition, at, pids, options.seconds, screen)
        status = await ask_status(at)
    finally:
        for camera in cameras:
            camera.terminate()
        for camera in cameras:
            camera.wait()
        await give_order(at, StopRig())
    return conditions, await _measure_idle(status, options, environment)


def _start_camera(number: int, leader: Address, folder: Path) -> subprocess.Popen[bytes]:
    name = f"cam{number:02d}"
    camera = ("--name", name, "--camera", "sim:phone-b,scale=0.1,drops=0,outliers=0", "--clock", "sim")
    rest = ("--leader", str(leader), "--spool", str(folder / "spool"))
    command = [sys.executable, "-m", "capture_app.cli", "node", *camera, *rest]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL)


async def _run(
    condition: Condition,
    leader: Address,
    pids: Sequence[int],
    seconds: float,
    screen: ScreenProcess | None,
) -> None:
    """Take bursts for so long, and add what was seen."""

    def rig_s() -> float:
        return sum(map(processor_s, pids))

    before = await ask_status(leader)
    began_s, began_rig_s = time.monotonic(), rig_s()
    screen_s, drawn = (screen.processor_s(), screen.drawn_bytes) if screen is not None else (0.0, 0)
    counting = asyncio.create_task(_count_updates(leader, condition)) if screen is not None else None
    while time.monotonic() - began_s < seconds:
        due_s = time.monotonic() + BURST_EVERY_S
        await _take_burst(condition, leader)
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))
    condition.seconds += time.monotonic() - began_s
    condition.rig_s += rig_s() - began_rig_s
    if screen is not None and counting is not None:
        condition.screen_s += screen.processor_s() - screen_s
        condition.drawn_bytes += screen.drawn_bytes - drawn
        counting.cancel()
    condition.drops += _drops(await ask_status(leader)) - _drops(before)


async def _take_burst(
    condition: Condition, leader: Address, *, wait_ready_s: float = 0.0, nodes: int = 1
) -> None:
    request = BurstRequest(frames=FRAMES, wait_ready_s=wait_ready_s, nodes=nodes)
    key_ns = time.monotonic_ns()
    done = [status async for status in ask_burst(leader, request)][-1]
    condition.bursts += 1
    condition.missing += done.expected - done.received
    if done.session is None:
        return
    manifest = Session.open(Path(done.session)).manifest
    # The leader's clock is the host's.
    condition.key_to_first_ms.append((manifest.burst.instants_ns[0] - key_ns) / 1e6)
    condition.images += len(manifest.images)
    condition.late += sum(image.late for image in manifest.images)
    condition.residuals_us += [abs(image.residual_ns) / 1000.0 for image in manifest.images]


async def _count_updates(leader: Address, condition: Condition) -> None:
    """How many statuses a screen is sent."""
    async for update in RigLink(leader).updates():
        condition.updates += isinstance(update, RigStatus)


def _drops(status: RigStatus) -> int:
    return sum(node.drops for node in status.nodes)


@dataclass(frozen=True)
class Unchanged:
    """A rig in which nothing changes."""

    rig: RigStatus

    def status(self) -> RigStatus:
        """The same for ever."""
        return self.rig


async def _measure_idle(status: RigStatus, options: Namespace, environment: dict[str, str]) -> Condition:
    """A screen on a rig in which nothing changes."""
    idle = Condition("unchanged")
    rig, viewfinders = cast(RigState, Unchanged(status)), Viewfinders()

    async def serve(channel: Channel[ToLeader]) -> None:
        if isinstance(await channel.receive_header(), StatusRequest):
            await channel.send(StatusAnswer(rig=status))
        else:
            await Watcher(channel, rig, Log(), viewfinders).serve()

    datagrams, listening = bind_port("127.0.0.1", 0)
    server = TransferServer[ToLeader](ToLeader, serve)
    await server.start(listening)
    at = Address("127.0.0.1", listening.getsockname()[1])
    try:
        with ScreenProcess("--leader", str(at), environment=environment) as screen:
            await asyncio.to_thread(screen.wait_until_drawn)
            talk("half a minute in which nothing happens, and then what that costs")
            # The strips of phases show half a minute: until that is over they move.
            await asyncio.sleep(options.idle_settle)
            began_s, drawn, screen_s = time.monotonic(), screen.drawn_bytes, screen.processor_s()
            await asyncio.sleep(options.seconds)
            idle.seconds = time.monotonic() - began_s
            idle.screen_s = screen.processor_s() - screen_s
            idle.drawn_bytes = screen.drawn_bytes - drawn
    finally:
        await server.stop()
        datagrams.close()
    return idle


def _report(options: Namespace, conditions: list[Condition], idle: Condition) -> int:
    rows = []
    for one in (*conditions, idle):
        keys, residuals = sorted(one.key_to_first_ms), sorted(one.residuals_us)
        rows.append(
            {
                "screen": one.name,
                "cores": round(one.screen_s / one.seconds, 3),
                "kB/s": round(one.drawn_bytes / one.seconds / 1000, 2),
                "updates/s": round(one.updates / one.seconds, 1),
                "cores of cameras": round(one.rig_s / one.seconds, 2),
                "bursts": one.bursts,
                "drops": one.drops,
                "missing": one.missing,
                "late": one.late,
                "key to first ms": round(keys[len(keys) // 2], 1) if keys else None,
                "most": round(keys[-1], 1) if keys else None,
                "residual us": round(residuals[len(residuals) // 2], 1) if residuals else None,
                "most us": round(residuals[-1], 1) if residuals else None,
            }
        )
    without, *with_screen = conditions
    misses = [
        f"the screen takes {one.screen_s / one.seconds:.2f} of a core with {one.name}"
        for one in with_screen
        if one.screen_s / one.seconds > MOST_UI_CORES
    ]
    misses += [
        f"{one.drops} drops with {one.name}, {without.drops} without a screen"
        for one in with_screen
        if one.drops > without.drops
    ]
    if idle.screen_s / idle.seconds > MOST_IDLE_CORES:
        misses.append(f"the idle screen takes {idle.screen_s / idle.seconds:.3f} of a core")
    if idle.drawn_bytes / idle.seconds > MOST_IDLE_BYTES:
        misses.append(f"the idle screen draws {idle.drawn_bytes / idle.seconds:.0f} bytes/s")
    print_report(
        {"rows": rows, "missed": misses, "load_average": os.getloadavg()[0]}, _print, as_json=options.json
    )
    for miss in misses:
        talk(f"missed: {miss}")
    return 1 if misses else 0


def _print(report: Report) -> None:
    rows = report["rows"]
    print_table(tuple(rows[0]), [tuple("-" if v is None else str(v) for v in row.values()) for row in rows])
    print(f"load average of the machine: {report['load_average']:.1f}")


def _options() -> Namespace:
    parser = new_parser(__doc__)
    parser.add_argument("--cameras", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each condition in each turn")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument(
        "--idle-settle", type=float, default=45.0, help="seconds before an idle screen counts"
    )
    parser.add_argument("--quick", action="store_true", help="one turn of 10 s")
    options = parser.parse_args()
    if options.quick:
        options.turns, options.seconds = 1, 10.0
    return options


if __name__ == "__main__":
    sys.exit(main())
