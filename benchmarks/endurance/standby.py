"""Two ranked leaders, of which the one that leads is killed again and again: is each burst whole, and true?

Leaders and cameras are processes of their own, on this machine's loopback, each with a simulated clock. After
each kill (SIGKILL) a burst is ordered of the other leader as soon as one camera has joined it; it has to name
the cameras that it lacks. Its images' times are compared with that leader's clock, and that clock with the
killed leader's. Then the killed one is started again, and follows. Returns 0 if each burst is complete and
every hard bound holds, else 1.

    python -m benchmarks.endurance.standby --kills 20
"""

import asyncio
import json
import signal
import socket
import sys
import tempfile
import time
from argparse import Namespace
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.endurance.soak import JOIN_S, camera_command, wait_until_ready
from benchmarks.report import new_parser, print_report, print_table
from capture_app.common.address import Address, parse_address
from capture_app.common.child import Child
from capture_app.common.clock import seeded_clock
from capture_app.common.errors import SimulshotError
from capture_app.common.host_clock import host_ns
from capture_app.common.node_state import NodeState
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.standby import lead_by_rank
from capture_app.protocol.log import Log
from capture_app.protocol.messages import BurstRequest
from capture_app.rig.rig_link import RigLink, ask_status
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify

FOLLOWED_S = 6.0
"""Time for which a standby has followed before its leader is killed."""
LEADS, FOLLOWS = "LEADS ", " leads: this one follows"
SPAN_NS = 10**12


@dataclass(slots=True)
class Machine:
    """A ranked leader: its process, and the line of its clock while it leads."""

    address: Address
    folder: Path
    child: Child
    line: tuple[int, int, int] | None = None
    """A true time, and the leader clock's reading then and SPAN_NS later."""

    def leader_ns(self, true_ns: int) -> int:
        """Return the reading of its leader clock at a true time."""
        assert self.line is not None
        at_ns, shown_ns, later_ns = self.line
        return shown_ns + round((true_ns - at_ns) * (later_ns - shown_ns) / SPAN_NS)


@dataclass(slots=True)
class Run:
    """Results of the kills."""

    back_s: list[float] = field(default_factory=list)
    """Time from each kill until all cameras had joined the other leader."""
    jumps_us: list[float] = field(default_factory=list)
    jumps_over: int = 0
    partial: int = 0
    """Bursts that named cameras that were missing."""
    images: int = 0
    within_95: int = 0
    over_bound: int = 0
    errors_us: list[float] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)


async def lead(name: str, options: Namespace) -> None:
    """Run as one of the leaders, until killed."""
    at = parse_address(options.lead)

    def make_options() -> LeaderOptions:
        return LeaderOptions(
            host=at.host,
            port=at.port,
            sessions=Path(options.sessions),
            clock=seeded_clock(name),
            log=Log(lambda line: print(line, file=sys.stderr, flush=True)),
        )

    async def serve(node: LeaderNode) -> None:
        now_ns, clock, continued = host_ns(), node.options.clock, node.options.continued
        told = (
            None
            if continued is None
            else (continued.upstream_map.uncertainty_ns, continued.upstream_map.hard_bound_ns)
        )
        line = now_ns, clock.local_from_true(now_ns), clock.local_from_true(now_ns + SPAN_NS)
        print(LEADS + json.dumps({"line": line, "told": told}), file=sys.stderr, flush=True)
        await node.service.stop_requested.wait()

    await lead_by_rank(make_options, [parse_address(one) for one in options.among], serve)


async def start_leader(address: Address, among: list[Address], folder: Path, name: str) -> Machine:
    """Start one of the leaders."""
    arguments = ["--lead", str(address), "--name", name, "--sessions", str(folder)]
    for one in among:
        arguments += ["--among", str(one)]
    return Machine(address, folder, await Child.start(name, ("benchmarks.endurance.standby", *arguments)))


async def says(machine: Machine, text: str) -> str:
    """Wait until its output contains this text, and return the last such line."""
    async with asyncio.timeout(JOIN_S):
        while True:
            found = [line for line in machine.child.said if text in line]
            if found:
                return found[-1]
            if machine.child.process.returncode is not None:
                raise await machine.child.failure()
            await asyncio.sleep(0.05)


async def note_lead(machine: Machine) -> tuple[float, float] | None:
    """Wait until it leads, and return the errors that it reports for the time it took over."""
    told = json.loads((await says(machine, LEADS)).partition(LEADS)[2])
    machine.line = tuple(told["line"])
    return None if told["told"] is None else (told["told"][0], told["told"][1])


async def wait_for_cameras(machine: Machine, cameras: int) -> None:
    """Wait until at least this many cameras have joined."""
    async with asyncio.timeout(JOIN_S):
        while True:
            with suppress(SimulshotError):
                nodes = (await ask_status(machine.address)).nodes
                if sum(n.name.startswith("cam") and n.state is not NodeState.LOST for n in nodes) >= cameras:
                    return
            await asyncio.sleep(0.02)


async def kill_and_take(run: Run, leader: Machine, other: Machine, cameras: int) -> None:
    """Kill the leader, take a burst of the other one once it has a camera, and judge both."""
    leader.child.process.send_signal(signal.SIGKILL)
    killed_s, killed_ns = time.monotonic(), host_ns()

    async def wait_for_all() -> None:
        await wait_for_cameras(other, cameras)
        run.back_s.append(time.monotonic() - killed_s)

    told, back = await note_lead(other), asyncio.create_task(wait_for_all())
    await wait_for_cameras(other, 1)
    try:
        *_, done = [status async for status in RigLink(other.address).burst(BurstRequest(frames=3))]
    except SimulshotError as error:
        run.wrong.append(f"no burst: {error}")
        await back
        return
    await back
    jump_ns = abs(other.leader_ns(killed_ns) - leader.leader_ns(killed_ns))
    run.jumps_us.append(jump_ns / 1000.0)
    run.jumps_over += told is None or jump_ns > told[1]
    run.partial += done.cameras < cameras
    unnamed = cameras - done.cameras - done.message.count("without cam")
    if done.session is None or done.received != done.expected or unnamed:
        run.wrong.append(f"kill {len(run.back_s)}: {done.received} of {3 * cameras} images {done.message}")
    if done.session is not None:
        judge(run, Path(done.session), other)


def judge(run: Run, folder: Path, leader: Machine) -> None:
    """Compare the times of a session with its leader's clock."""
    session = Session.open(folder)
    run.wrong += [f"{folder.name}: {problem}" for problem in verify(session)]
    times = session.true_times()
    assert times is not None, "the cameras are simulated"
    for image in session.manifest.images:
        assert image.local_ns is not None
        assert image.hard_bound_ns is not None
        assert image.uncertainty_ns is not None
        true_ns = times.clocks[image.camera].true_from_local(image.local_ns)
        error_ns = abs(image.leader_ns - leader.leader_ns(true_ns))
        run.images += 1
        run.errors_us.append(error_ns / 1000.0)
        run.within_95 += error_ns <= image.uncertainty_ns
        run.over_bound += error_ns > image.hard_bound_ns


async def repeat(options: Namespace, folder: Path) -> Run:
    """Run the rig, and kill its leaders in turn."""
    run, ports = Run(), [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
    among = [Address("127.0.0.1", one.getsockname()[1]) for one in ports]
    for one in ports:
        one.close()
    leader = await start_leader(among[0], among, folder / "0", "leader0")
    children = []
    try:
        await note_lead(leader)
        other = await start_leader(among[1], among, folder / "1", "leader1")
        for number in range(options.cameras):
            command = camera_command(f"cam{number}", folder, *among)
            children.append(await Child.start(f"cam{number}", ("capture_app.cli", *command)))
        for kill in range(options.kills):
            await says(other, FOLLOWS)
            await wait_until_ready(leader.address, options.cameras + 1)
            await asyncio.sleep(FOLLOWED_S)
            await kill_and_take(run, leader, other, options.cameras)
            name = f"leader{among.index(leader.address)}"
            back = f"all back after {run.back_s[-1]:.2f} s, {run.partial} partial bursts"
            print(f"kill {kill + 1}: {back}", file=sys.stderr, flush=True)
            again = await start_leader(leader.address, among, leader.folder, name)
            await leader.child.stop()
            leader, other = other, again
    finally:
        await asyncio.gather(*(child.stop() for child in (*children, leader.child, other.child)))
    return run


def report_of(run: Run, options: Namespace) -> dict[str, Any]:
    """Return the figures in the form in which they are printed."""
    return {
        "kind": "real (loopback), simulated cameras",
        "kills": len(run.back_s),
        "cameras": options.cameras,
        "partial": run.partial,
        "back_s": {"mean": sum(run.back_s) / len(run.back_s), "max": max(run.back_s)},
        "jump_us": {"max": max(run.jumps_us, default=0.0), "over_told_bound": run.jumps_over},
        "images": run.images,
        "error_us": {
            "mean": sum(run.errors_us) / max(1, run.images),
            "max": max(run.errors_us, default=0.0),
        },
        "within_95": run.within_95 / max(1, run.images),
        "over_bound": run.over_bound,
        "wrong": run.wrong,
    }


def print_tables(report: dict[str, Any]) -> None:
    """Print a report as tables."""
    back, error, jump = report["back_s"], report["error_us"], report["jump_us"]
    print_table(
        (
            "kills",
            "all back in s, mean",
            "largest",
            "step of the time, us",
            "pictures",
            "off by us",
            "largest",
        ),
        [
            (
                str(report["kills"]),
                f"{back['mean']:.2f}",
                f"{back['max']:.2f}",
                f"{jump['max']:.1f}",
                str(report["images"]),
                f"{error['mean']:.1f}",
                f"{error['max']:.1f}",
            )
        ],
    )
    print(
        f"{100 * report['within_95']:.0f} % within their 95 %; {report['over_bound']} over their hard bound,"
        f" and {jump['over_told_bound']} steps over theirs"
    )
    for line in report["wrong"]:
        print(f"WRONG: {line}")


def main() -> int:
    """Run it; return 0 if each burst was complete and every hard bound held."""
    parser = new_parser(__doc__)
    parser.add_argument("--kills", type=int, default=20, help="how often a leader is killed (20)")
    parser.add_argument("--cameras", type=int, default=3, help="simulated cameras (3)")
    for own in ("--lead", "--name", "--sessions"):
        parser.add_argument(own, help="of one of the leaders, which this starts itself")
    parser.add_argument("--among", action="append", help="all leaders, of one of these")
    options = parser.parse_args()
    if options.lead:
        asyncio.run(lead(options.name, options))
        return 0
    with tempfile.TemporaryDirectory(prefix="standby-") as temporary:
        run = asyncio.run(repeat(options, Path(temporary)))
    print_report(report_of(run, options), print_tables, as_json=options.json)
    return 1 if run.wrong or run.over_bound or run.jumps_over else 0


if __name__ == "__main__":
    sys.exit(main())
