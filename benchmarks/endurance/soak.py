"""A rig of simulated cameras that takes one burst after the other, and whether any of it grows.

Leader and nodes are processes of their own, on this machine's loopback, with simulated clocks. Threads,
memory and open files of each process, and the phase error of each camera, are read after each burst; the
phases between bursts, too, each second, and the largest of each camera is said. By its
slope, past the warming up, none may grow by more than its limit; every burst must be whole, every session
verify, and its pictures' true errors lie within their hard bounds. 0 if all that holds, 1 if not.

    python -m benchmarks.endurance.soak --seconds 120
    python -m benchmarks.endurance.soak --bursts 2000 --seconds 7200
    python -m benchmarks.endurance.soak --seconds 3600 --cameras 5 --every 20
"""

import asyncio
import shutil
import statistics
import sys
import tempfile
from argparse import Namespace
from collections import defaultdict
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.endurance.slopes import growth
from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.common.address import Address, parse_address
from capture_app.common.child import Child
from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.protocol.messages import BurstRequest
from capture_app.rig.rig_link import RigLink, ask_status
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify

MB = float(1 << 20)
CAMERA = "sim:phone-a,scene=bars,scale=0.2,drops=0,outliers=0"
JOIN_S = 300.0
TOLERANCE_US = 500.0

LIMITS = {"threads": 4.0, "files": 6.0, "memory_mb": 12.0, "phase_us": TOLERANCE_US}
"""Maximum growth of each figure in a run of any length, e.g. by a pool or a ring that still fills."""


FEWEST = 6
"""Minimum number of bursts of a meaningful run."""
LOOK_EVERY_S, TALK_EVERY_S = 1.0, 300.0


@dataclass(slots=True)
class Watched:
    """A process of the rig, with its recorded figures."""

    child: Child
    series: dict[str, list[tuple[float, float]]] = field(default_factory=lambda: defaultdict(list))

    def read(self, burst: int) -> None:
        """Record the process's figures after that burst."""
        place = Path("/proc") / str(self.child.process.pid)
        status = dict(line.split(":", 1) for line in (place / "status").read_text().splitlines())
        self.series["threads"].append((burst, float(status["Threads"])))
        self.series["memory_mb"].append((burst, float(status["VmRSS"].split()[0]) * 1024 / MB))
        self.series["files"].append((burst, float(len(list((place / "fd").iterdir())))))


@dataclass(slots=True)
class Soak:
    """A run: its processes, and the results of its bursts."""

    leader: Address
    processes: dict[str, Watched]
    bursts: int = 0
    images: int = 0
    incomplete: list[str] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    """Output of `verify` for faulty sessions."""
    over_bound: int = 0
    """Number of images whose true error exceeds their hard bound."""
    phases: dict[str, list[tuple[float, float]]] = field(default_factory=lambda: defaultdict(list))
    between: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    """Absolute phase errors of each camera, including those between bursts, in us."""
    not_ready: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    """Number of times that a camera was in another state than ready."""

    async def take(self, request: BurstRequest, *, keep: bool) -> None:
        """Take one burst and judge it."""
        self.bursts += 1
        try:
            *_, done = [status async for status in RigLink(self.leader).burst(request)]
        except SimulshotError as error:
            self.incomplete.append(f"burst {self.bursts}: {error}")
            return
        if done.session is None or done.received < done.expected or not done.received:
            self.incomplete.append(f"burst {done.burst}: {done.received}/{done.expected} {done.message}")
        if done.session is not None:
            await asyncio.to_thread(self._judge, Path(done.session), keep)

    def _judge(self, folder: Path, keep: bool) -> None:
        session = Session.open(folder)
        self.broken += [f"{folder.name}: {problem}" for problem in verify(session)]
        times = session.true_times()
        for image in session.manifest.images:
            self.images += 1
            if times is not None and image.local_ns is not None and image.hard_bound_ns is not None:
                # The leader's clock is this host's, which is the true time.
                true_ns = times.clocks[image.camera].true_from_local(image.local_ns)
                self.over_bound += abs(image.leader_ns - true_ns) > image.hard_bound_ns
        if not keep:
            shutil.rmtree(folder)

    async def look(self) -> None:
        """Record the figures of all processes, and the phases of all cameras."""
        for process in self.processes.values():
            process.read(self.bursts)
        for name, phase_us in (await self._phases_us()).items():
            self.phases[name].append((self.bursts, phase_us))

    async def watch(self, until_s: float) -> None:
        """Record the phases of all cameras each second, until this time of the event loop."""
        loop = asyncio.get_running_loop()
        while (left_s := until_s - loop.time()) > 0:
            await asyncio.sleep(min(LOOK_EVERY_S, left_s))
            await self._phases_us()

    async def _phases_us(self) -> dict[str, float]:
        found: dict[str, float] = {}
        try:
            nodes = (await ask_status(self.leader)).nodes
        except SimulshotError as error:
            self.incomplete.append(f"no status after burst {self.bursts}: {error}")
            return found
        for node in nodes:
            self.not_ready[node.name] += node.state is not NodeState.READY
            if node.phase_error_ns is not None and node.state in (NodeState.READY, NodeState.DEGRADED):
                found[node.name] = abs(node.phase_error_ns) / 1000.0
                self.between[node.name].append(found[node.name])
        return found

    def largest_us(self) -> float:
        """Return the largest phase error seen in any camera that takes images."""
        return max((max(of) for of in self.between.values()), default=0.0)

    def figures(self) -> list[dict[str, Any]]:
        """Return the first and last value of each figure, its growth by the slope, and its limit."""
        series = [(name, kind, of) for name, one in self.processes.items() for kind, of in one.series.items()]
        series += [(name, "phase_us", of) for name, of in sorted(self.phases.items())]
        return [
            {
                "process": name,
                "kind": kind,
                "first": of[0][1],
                "last": of[-1][1],
                "growth": growth(of),
                "limit": LIMITS[kind],
            }
            for name, kind, of in series
        ]

    def complaints(self) -> list[str]:
        """Return the faults other than incomplete bursts, as lines; empty if there are none."""
        grown = [
            f"{of['process']}: {of['kind']} grew by {of['growth']:.1f}, over its limit of {of['limit']:g}"
            for of in self.figures()
            if of["growth"] > of["limit"]
        ]
        bound = (
            [f"{self.over_bound} pictures are further off than their hard bound"] if self.over_bound else []
        )
        few = [] if self.bursts >= FEWEST else [f"only {self.bursts} bursts: too few to tell of any slope"]
        return [*few, *grown, *bound, *self.broken]


async def soak(options: Namespace, folder: Path) -> Soak:
    """Run a rig for this time, or this many bursts, and return the results."""
    async with rig(options.cameras, folder) as run:
        # Frames from before the request need no lead time.
        request = BurstRequest(frames=options.frames, before=0 if options.every else options.frames)
        loop = asyncio.get_running_loop()
        began_s = due_s = told_s = loop.time()
        while loop.time() - began_s < options.seconds and run.bursts < options.bursts:
            await run.take(request, keep=options.keep is not None)
            await run.look()
            if loop.time() - told_s > TALK_EVERY_S:
                told_s = loop.time()
                talk(
                    f"{told_s - began_s:.0f} s: {run.bursts} bursts, {len(run.incomplete)} not whole,"
                    f" {run.images} images, largest phase error {run.largest_us():.0f} us"
                )
            due_s = max(loop.time(), due_s + options.every)
            await run.watch(due_s)
        return run


@asynccontextmanager
async def rig(cameras: int, folder: Path) -> AsyncIterator[Soak]:
    """Run a leader and its nodes as processes, and wait until all are ready."""
    where = ("--host", "127.0.0.1", "--port", "0", "--sessions", str(folder / "sessions"))
    processes = {"leader": await start("leader", "leader", *where)}
    try:
        leader = await listening(processes["leader"].child)
        for number in range(1, cameras + 1):
            name = f"cam{number}"
            processes[name] = await start(name, *camera_command(name, folder, leader))
        await wait_until_ready(leader, cameras)
        yield Soak(leader, processes)
    finally:
        await asyncio.gather(*(of.child.stop() for of in processes.values()))


async def start(name: str, command: str, *arguments: str) -> Watched:
    """Start a command of capture-app that ends when this process does."""
    return Watched(await Child.start(name, ("capture_app.cli", command, *arguments)))


async def listening(child: Child, said: str = "leader at ") -> Address:
    """Return the address of a leader, or of a relay, from its output."""
    async with asyncio.timeout(JOIN_S):
        while True:
            for line in child.said:
                if said in line:
                    return parse_address(line.partition(said)[2].partition(",")[0])
            if child.process.returncode is not None:
                raise await child.failure()
            await asyncio.sleep(0.1)


def camera_command(name: str, folder: Path, *leaders: Address) -> list[str]:
    """Return the command of a simulated camera's node."""
    own = ["node", "--until-eof", "--name", name, "--camera", CAMERA, "--clock", "sim"]
    asked = [word for leader in leaders for word in ("--leader", str(leader))]
    return [*own, "--spool", str(folder / "spool"), *asked]


async def wait_until_ready(leader: Address, nodes: int) -> None:
    """Wait until there are this many nodes, all aligned."""
    states: list[NodeState] = []
    async with asyncio.timeout(JOIN_S):
        while len(states) != nodes or not {*states} <= {NodeState.READY, NodeState.DEGRADED}:
            await asyncio.sleep(0.2)
            states = [node.state for node in (await ask_status(leader)).nodes]


def report_of(run: Soak, options: Namespace, complaints: list[str]) -> dict[str, Any]:
    """Return the figures in the form in which they are printed."""
    return {
        "kind": "real (loopback), simulated cameras",
        "cameras": options.cameras,
        "bursts": run.bursts,
        "images": run.images,
        "over_bound": run.over_bound,
        "figures": run.figures(),
        "phases": [
            {
                "camera": name,
                "looks": len(of),
                "median_us": statistics.median(of),
                "p99_us": sorted(of)[int(0.99 * len(of))],
                "largest_us": max(of),
                "not_ready": run.not_ready[name],
            }
            for name, of in sorted(run.between.items())
        ],
        "complaints": complaints,
    }


def print_tables(report: dict[str, Any]) -> None:
    """Print a report as tables."""
    print_rows(
        report["figures"],
        {
            "process": ("process", ""),
            "kind": ("figure", ""),
            "first": ("first", ".1f"),
            "last": ("last", ".1f"),
            "growth": ("growth", ".2f"),
            "limit": ("limit", "g"),
        },
    )
    print_rows(
        report["phases"],
        {
            "camera": ("phase errors of", ""),
            "looks": ("looks", "d"),
            "median_us": ("median, us", ".0f"),
            "p99_us": ("99 %", ".0f"),
            "largest_us": ("largest", ".0f"),
            "not_ready": ("times not ready", "d"),
        },
    )
    print(
        f"{report['bursts']} bursts, {report['images']} images, {report['over_bound']} over their hard bound"
    )
    for line in report["complaints"]:
        print(f"WRONG: {line}")


def main() -> int:
    """Run it; return 0 if nothing grows and every burst is complete, else 1."""
    parser = new_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=120.0, help="length of the run (120)")
    parser.add_argument("--bursts", type=int, default=1_000_000, help="end after so many bursts")
    parser.add_argument("--cameras", type=int, default=2, help="simulated cameras (2)")
    parser.add_argument("--frames", type=int, default=2, help="frames of each burst (2)")
    parser.add_argument("--every", type=float, default=0.0, help="seconds between bursts (0: at once)")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the sessions in this folder")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="soak-") as temporary:
        run = asyncio.run(soak(options, options.keep or Path(temporary)))
    complaints = [*run.complaints(), *run.incomplete]
    print_report(report_of(run, options, complaints), print_tables, as_json=options.json)
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main())
