"""Recordings by real processes: what is lost, how memory grows, and what a kill leaves.

    python -m benchmarks.sessions.recording [--cameras 4] [--seconds 600] [--kills 0] [--outages 0]

One leader and a node a camera on this machine, each a process of its own; each camera hands over 1920x1080
JPEGs of about 250 kB from its memory, 30 a second (a simulated camera, a real load: see `memory_node`). It
records for so long, counts frames and what each camera dropped, measures each process's memory, verifies.
With `--kills` it then takes a burst, or records for a few seconds, as often again, sends SIGKILL to the
leader or to a node at a random moment, starts it again, and looks whether every frame that was on the
leader's disk then is in the session in the end. `--outages` does the same with processes that stand still
(SIGSTOP) for longer than it takes to be given up, and go on. `--within 30` kills as often within the long
recording: a camera, the leader, all cameras, in turn, each started again after a second. Then it lists the
frames that are missing of cameras that were there: neither killed nor on their way back.
"""

import argparse
import asyncio
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from benchmarks.report import Report, new_parser, print_report, print_table, talk
from benchmarks.sessions.memory_node import pictures, write_film
from capture_app.common.address import Address
from capture_app.common.clock import HostClock
from capture_app.common.errors import SimulshotError
from capture_app.protocol.status import NodeStatus
from capture_app.rig.rig_link import ask_status
from capture_app.session.format.manifest import JOURNAL, MANIFEST
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify

WIDTH, HEIGHT = 1920, 1080
TIMEOUT_S = 300.0
SAMPLE_EVERY_S, SAMPLES_AT_LEAST = 5.0, 12
UNWRITTEN_NS = 500_000_000
"""What a camera took so shortly before its kill may not be on its disk."""
BURST_FRAMES, OUTAGE_S = 60, 6.0
"""An outage is more than twice the silence after which a member, or its leader, counts as lost."""


class Rig:
    """A leader and its nodes as processes."""

    def __init__(self, folder: Path, film: Path, cameras: int, port: int) -> None:
        self.folder = folder
        self.names = [f"cam{number}" for number in range(cameras)]
        self.address = Address("127.0.0.1", port)
        self._film = film
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def sessions(self) -> Path:
        """Folder in which the leader saves sessions."""
        return self.folder / "sessions"

    @property
    def spool(self) -> Path:
        """Folder in which nodes keep what the leader does not have yet."""
        return self.folder / "spool"

    def start(self, name: str) -> None:
        """Start the leader, or a node."""
        if name == "leader":
            where = ["--host", self.address.host, "--port", str(self.address.port)]
            module, words = "capture_app.cli", ["leader", *where, "--sessions", str(self.sessions)]
        else:
            film, leader, spool = str(self._film), str(self.address), str(self.spool / name)
            module, words = "benchmarks.sessions.memory_node", [film, "30", leader, name, spool]
        with (self.folder / f"{name}.log").open("ab") as log:
            self._running[name] = subprocess.Popen(
                [sys.executable, "-m", module, *words],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, "XDG_STATE_HOME": str(self.folder / "state")},
            )

    def kill(self, name: str) -> None:
        """Kill a process as a power cut would."""
        self._running[name].send_signal(signal.SIGKILL)
        self._running[name].wait()

    def stand_still(self, name: str, *, still: bool) -> None:
        """Suspend a process, or resume it."""
        self._running[name].send_signal(signal.SIGSTOP if still else signal.SIGCONT)

    def close(self) -> None:
        """End all processes."""
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            process.wait()

    def resident_mb(self) -> dict[str, float]:
        """Return the resident memory of each process, in MB, without shared memory."""
        found = {}
        for name, process in self._running.items():
            lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
            found[name] = next(int(line.split()[1]) / 1000 for line in lines if line.startswith("RssAnon"))
        return found

    async def wait_until_ready(self) -> None:
        """Wait until all cameras are ready."""
        async with asyncio.timeout(TIMEOUT_S):
            while True:
                try:
                    nodes = (await ask_status(self.address)).nodes
                except SimulshotError:
                    nodes = ()
                if {node.name for node in nodes if node.state == "ready"} >= {*self.names}:
                    return
                await asyncio.sleep(0.1)

    def take(self, *words: str) -> "subprocess.Popen[bytes]":
        """Start a command that records or takes a burst, and return its process."""
        return subprocess.Popen(
            [
                *(sys.executable, "-m", "capture_app.cli", words[0], "--leader", str(self.address)),
                *(*words[1:], "--json"),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "XDG_STATE_HOME": str(self.folder / "state")},
        )


async def record_long(rig: Rig, seconds: float) -> Report:
    """Make one recording of that length, and measure the memory of all processes meanwhile."""
    recording = rig.take("record", "--seconds", str(seconds))
    began_s, memory = time.monotonic(), []
    while recording.poll() is None:
        await asyncio.sleep(min(SAMPLE_EVERY_S, seconds / SAMPLES_AT_LEAST))
        memory.append((time.monotonic() - began_s, rig.resident_mb()))
        if len(memory) % 12 == 0:
            talk(
                f"{memory[-1][0]:.0f} s: " + ", ".join(f"{n} {mb:.0f} MB" for n, mb in memory[-1][1].items())
            )
    done = json.loads(recording.communicate()[0])
    session = Session.open(Path(done["session"]))
    manifest = session.manifest
    size = sum(video.bytes for video in manifest.videos)
    reasons = sorted({gap.reason for gap in manifest.missing})
    half = [row for row in memory if row[0] < seconds]
    return {
        "seconds": seconds,
        "instants": len(manifest.burst.instants_ns),
        "frames": {video.camera: video.frames for video in manifest.videos},
        "missing": len(manifest.missing),
        "dropped_by_a_camera": sum(gap.dropped for gap in manifest.missing),
        "reasons": reasons,
        "mb": size / 1e6,
        "mb_per_s": size / 1e6 / seconds,
        "problems": [str(problem) for problem in verify(session)],
        "memory_mb": {
            name: {
                "early": half[len(half) // 6][1][name],
                "late": half[-1][1][name],
                "most": max(row[1][name] for row in half),
            }
            for name in half[0][1]
        },
    }


class Watch:
    """When each camera was away, by the leader's clock: from its kill until a status calls it ready."""

    def __init__(self, rig: Rig) -> None:
        self.away_ns: dict[str, list[tuple[int, int]]] = {name: [] for name in rig.names}
        self._rig, self._since_ns = rig, dict[str, int]()
        self._missed = set[str]()
        """Cameras whose loss the leader has noticed; until then it calls a killed one ready."""

    def note_killed(self, name: str) -> None:
        """Note that a camera was killed now; what it had not written yet may be gone."""
        self._since_ns.setdefault(name, HostClock().now_ns())
        self._missed.discard(name)

    async def follow(self) -> None:
        """Ask the leader again and again which cameras are ready."""
        while True:
            nodes: tuple[NodeStatus, ...] = ()
            with suppress(SimulshotError):
                nodes = (await ask_status(self._rig.address)).nodes
            for node in nodes:
                if node.state != "ready":
                    self._missed.add(node.name)
                elif node.name in self._missed & self._since_ns.keys():
                    self.away_ns[node.name].append((self._since_ns.pop(node.name), HostClock().now_ns()))
            await asyncio.sleep(0.2)

    def was_there(self, name: str, at_ns: int) -> bool:
        """Whether that camera was alive and ready at that time, and for UNWRITTEN_NS more."""
        spans = [*self.away_ns[name], (self._since_ns.get(name, math.inf), math.inf)]
        return not any(from_ns - UNWRITTEN_NS <= at_ns <= until_ns for from_ns, until_ns in spans)


async def record_with_kills(rig: Rig, seconds: float, kills: int, chance: random.Random) -> Report:
    """Make one recording of that length, kill within it, and count what cameras that were there lack."""
    recording, watch = rig.take("record", "--seconds", str(seconds)), Watch(rig)
    following = asyncio.create_task(watch.follow())
    async with asyncio.timeout(TIMEOUT_S):
        await until(lambda: frames_safe(rig, set()) > 0)
    for number in range(kills):
        await asyncio.sleep(seconds / (kills + 1) * chance.uniform(0.6, 1.2) - 1.0)
        victims = ([chance.choice(rig.names)], ["leader"], rig.names)[number % 3]
        for name in victims:
            rig.kill(name)
            if name != "leader":
                watch.note_killed(name)
        await asyncio.sleep(1.0)
        for name in victims:
            rig.start(name)
        talk(f"{number + 1}: killed {', '.join(victims)}")
    said = json.loads((await asyncio.to_thread(recording.communicate))[0])
    folder = next(rig.sessions.iterdir())
    async with asyncio.timeout(TIMEOUT_S):
        await rig.wait_until_ready()
        await until(lambda: (folder / MANIFEST).exists() and not any(rig.spool.rglob("report.json")))
    following.cancel()
    session = Session.open(folder)
    manifest = session.manifest
    lacking = [
        (gap.camera, gap.instant, gap.reason)
        for gap in manifest.missing
        if watch.was_there(gap.camera, manifest.burst.instants_ns[gap.instant])
    ]
    return {
        "kills": kills,
        "exit": recording.returncode,
        "said": {key: value for key, value in said.items() if isinstance(value, int | str)},
        "ordered": manifest.expected_images,
        "saved": sum(video.frames for video in manifest.videos),
        "away_s": {name: sum(b - a for a, b in spans) / 1e9 for name, spans in watch.away_ns.items()},
        "lacking": lacking,
        "reasons": sorted({f"{gap.camera}: {gap.reason}" for gap in manifest.missing}),
        "problems": [str(problem) for problem in verify(session)],
    }


async def until(is_so: Callable[[], bool]) -> None:
    """Wait until the condition is true."""
    while not is_so():  # noqa: ASYNC110 - what another process does tells no event
        await asyncio.sleep(0.05)


def lines_on_disk(session: Path) -> dict[str, set[bytes]]:
    """Return the frames safely stored in a session, one line each, by the file of the lines."""
    found = {}
    for path in (*session.glob("videos/*/*.frames.ndjson"), *session.glob(JOURNAL)):
        found[path.name] = {line for line in path.read_bytes().split(b"\n")[:-1] if line}
    return found


def frames_safe(rig: Rig, before: set[str]) -> int:
    """Return the number of frames on the leader's disk in sessions that did not exist before."""
    new = [path for path in rig.sessions.iterdir() if path.name not in before]
    return sum(len(lines) for path in new for lines in lines_on_disk(path).values())


async def interrupt_once(rig: Rig, chance: random.Random, number: int, *, outage: bool) -> dict[str, Any]:
    """Start a capture, kill or suspend a process during it, and check the session."""
    before = {path.name for path in rig.sessions.iterdir()}
    words = ("record", "--seconds", "4") if number // 2 % 2 else ("burst", "--frames", str(BURST_FRAMES))
    moment = chance.randrange(BURST_FRAMES * len(rig.names))
    taking = rig.take(*words)
    async with asyncio.timeout(TIMEOUT_S):
        await until(lambda: any(path.name not in before for path in rig.sessions.iterdir()))
        # A random number of frames is safe by then; a capture that ends earlier is killed after its end.
        await until(lambda: taking.poll() is not None or frames_safe(rig, before) >= moment)
    victim = "leader" if number % 2 == 0 else chance.choice(rig.names)
    if outage:
        rig.stand_still(victim, still=True)
    else:
        rig.kill(victim)
    new = [path for path in rig.sessions.iterdir() if path.name not in before]
    safe = lines_on_disk(new[0]) if new else {}
    if outage:
        await asyncio.sleep(OUTAGE_S)
        rig.stand_still(victim, still=False)
    else:
        rig.start(victim)
    taking.communicate()
    lost, problems = 0, []
    if new:
        async with asyncio.timeout(TIMEOUT_S):
            await until(lambda: (new[0] / "session.json").exists())
        kept = lines_on_disk(new[0])
        lost = sum(len(lines - kept.get(name, set())) for name, lines in safe.items())
        problems = [str(problem) for problem in verify(Session.open(new[0]))]
    await rig.wait_until_ready()
    frames = sum(map(len, safe.values()))
    kind = "outage" if outage else "kill"
    result = {"kind": kind, "of": words[0], "victim": victim, "confirmed": frames, "lost": lost}
    result["problems"] = problems
    if new:
        manifest = Session.open(new[0]).manifest
        result |= {"in_the_end": len(manifest.images), "missing": len(manifest.missing)}
        shutil.rmtree(new[0])
    talk(f"{number + 1}: {result}")
    return result


async def measure(options: argparse.Namespace, folder: Path) -> Report:
    """Record for this duration, with this number of kills and outages."""
    images, film, cameras = pictures(WIDTH, HEIGHT), folder / "film.mjpeg", options.cameras
    write_film(film, (WIDTH, HEIGHT), images)
    mean_bytes = sum(map(len, images)) // len(images)
    rig = Rig(folder, film, cameras, options.port)
    rig.sessions.mkdir()
    chance = random.Random(options.seed)
    try:
        for name in ("leader", *rig.names):
            rig.start(name)
        await rig.wait_until_ready()
        talk(f"{cameras} cameras are ready; pictures of {mean_bytes / 1000:.0f} kB")
        report: Report = {"cameras": cameras, "picture_bytes": mean_bytes}
        if options.within:
            report["within"] = await record_with_kills(rig, options.seconds, options.within, chance)
        elif options.seconds:
            report["recording"] = await record_long(rig, options.seconds)
        turns = [*enumerate([False] * options.kills), *enumerate([True] * options.outages)]
        report["interruptions"] = [await interrupt_once(rig, chance, n, outage=of) for n, of in turns]
    finally:
        rig.close()
    return report


def print_tables(report: Report) -> None:
    """Print a report as tables."""
    recording = report.get("recording")
    if recording:
        print(f"{report['cameras']} cameras, {recording['seconds']:.0f} s, {recording['mb_per_s']:.1f} MB/s")
        print(
            f"{recording['instants']} instants, frames {recording['frames']}, missing {recording['missing']}"
        )
        print(f"dropped by a camera {recording['dropped_by_a_camera']}; reasons {recording['reasons']}")
        print(f"verify: {recording['problems'] or 'no problem'}")
        rows = [
            [name, f"{mb['early']:.0f}", f"{mb['late']:.0f}", f"{mb['most']:.0f}"]
            for name, mb in recording["memory_mb"].items()
        ]
        print_table(["process", "MB early", "MB at the end", "MB most"], rows)
    if within := report.get("within"):
        away = ", ".join(f"{name} {away_s:.0f} s" for name, away_s in within["away_s"].items())
        print(f"{within['kills']} kills within the recording; away: {away}")
        print(f"saved {within['saved']} of {within['ordered']}, exit {within['exit']}, said {within['said']}")
        print(f"missing of cameras that were there: {len(within['lacking'])} {within['lacking'][:20]}")
        print(f"verify: {within['problems'] or 'no problem'}")
    for kind in ("kill", "outage"):
        if turns := [one for one in report["interruptions"] if one["kind"] == kind]:
            confirmed, lost = sum(one["confirmed"] for one in turns), sum(one["lost"] for one in turns)
            bad = [problem for one in turns for problem in one["problems"]] or "no problem"
            print(f"{len(turns)} {kind}s: {lost} of {confirmed} confirmed frames lost; verify: {bad}")


def main() -> None:
    """Read the options, measure and print."""
    parser = new_parser(__doc__, seed_of="the moments of kills")
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--kills", type=int, default=0)
    parser.add_argument("--outages", type=int, default=0)
    parser.add_argument("--within", type=int, default=0, help="kills within the recording")
    parser.add_argument("--port", type=int, default=47811)
    parser.add_argument(
        "--dir", type=Path, default=None, help="where to work, instead of the temporary folder"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.dir) as folder:
        report = asyncio.run(measure(options, Path(folder)))
    print_report(report, print_tables, as_json=options.json)


if __name__ == "__main__":
    main()
