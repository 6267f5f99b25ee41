"""What a rig bears: the rate at which recordings of many cameras are saved, and what it costs.

    python -m benchmarks.sessions.throughput [--rig 8x60] [--rig 4x30] [--seconds 20] [--load 10] [--open]

One leader and one node a camera on this machine, each a process of its own. Each camera hands over 1920x1080
JPEGs of about 250 kB from its memory (a simulated camera, a real load), so nothing is read or encoded: see
`memory_node`. `--rig 8x60` is eight cameras at 60 frames a second, `--rig 8x15@4k` eight of 3840x2160.
`--load 10` runs as many busy processes beside all that. It counts what is on the leader's disk when the last
frame has been taken, how much later the rest was saved, the processor time of the leader and of a node for
1,000 frames, both without recording, and their memory. In the same minutes `ffmpeg -c copy` sends the
same JPEGs over TCP into files, if ffmpeg is installed, and so does a plain socket of Python, which syncs its
files each second. All share this machine's processors, so a rig on machines of its own bears more.
"""

import argparse
import asyncio
import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.report import Report, new_parser, print_report, print_table, talk
from benchmarks.sessions.memory_node import pictures, write_film
from capture_app.common.address import Address
from capture_app.common.errors import SimulshotError
from capture_app.rig.rig_link import ask_status
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.trust.trust import OPEN_VARIABLE

SIZES = {"": (1920, 1080), "4k": (3840, 2160)}
READY_S, AFTER_S = 120.0, 300.0
IDLE_S = 4.0
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")


class Processes:
    """Processes by name, and what they have used."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, *words: str | Path) -> "subprocess.Popen[bytes]":
        """Start a process, with its log in the folder."""
        with (self._folder / f"{name}.log").open("ab") as log:
            self._running[name] = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, "XDG_STATE_HOME": str(self._folder / "state")},
            )
        return self._running[name]

    def cpu_s(self) -> dict[str, float]:
        """Return each process's processor time, s."""
        used = {}
        for name, process in self._running.items():
            fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
            used[name] = (int(fields[11]) + int(fields[12])) / CLOCK_TICKS
        return used

    def resident_mb(self) -> dict[str, float]:
        """Return each process's resident memory without shared memory, MB."""
        found = {}
        for name, process in self._running.items():
            lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
            found[name] = next(int(line.split()[1]) / 1000 for line in lines if line.startswith("RssAnon"))
        return found

    def close(self) -> None:
        """End all processes."""
        for process in self._running.values():
            process.send_signal(signal.SIGTERM)
        for process in self._running.values():
            process.wait()


def of_kind(used: dict[str, float], leader: bool) -> float:
    """Return the sum over the leader, or over the nodes."""
    return sum(value for name, value in used.items() if (name == "leader") is leader)


async def wait_until_ready(address: Address, names: Iterable[str]) -> None:
    """Wait until all cameras are ready."""
    async with asyncio.timeout(READY_S):
        while True:
            try:
                nodes = (await ask_status(address)).nodes
            except SimulshotError:
                nodes = ()
            if {node.name for node in nodes if node.state == "ready"} >= {*names}:
                return
            await asyncio.sleep(0.2)


def film_bytes(sessions: Path) -> int:
    """Return the length of all films of the sessions."""
    return sum(path.stat().st_size for path in sessions.glob("*/videos/*/*.mjpeg"))


async def record(
    folder: Path,
    source: Path,
    cameras: int,
    fps: float,
    seconds: float,
    port: int,
    *,
    load: int,
    is_open: bool,
) -> Report:
    """Record once by real processes."""
    names = [f"cam{number}" for number in range(cameras)]
    sessions, address = folder / "sessions", Address("127.0.0.1", port)
    sessions.mkdir(parents=True)
    program = (sys.executable, "-m", "capture_app.cli")
    processes = Processes(folder)
    at_port = ("--host", address.host, "--port", str(port))
    loading = contextlib.ExitStack()
    try:
        processes.start("leader", *program, "leader", *at_port, "--sessions", sessions)
        for name in names:
            words = (str(source), f"{fps:g}", str(address), name, str(folder / "spool"))
            processes.start(name, sys.executable, "-m", "benchmarks.sessions.memory_node", *words)
        await wait_until_ready(address, names)
        before = processes.cpu_s()
        await asyncio.sleep(IDLE_S)
        at_rest = processes.cpu_s()
        loading.enter_context(busy(load))
        taking = subprocess.Popen(  # noqa: ASYNC220 - it is waited for below
            [*program, "record", "--leader", str(address), "--seconds", str(seconds), "--json"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "XDG_STATE_HOME": str(folder / "state")},
        )
        while not film_bytes(sessions):  # noqa: ASYNC110 - what another process does tells no event
            await asyncio.sleep(0.02)
        begun_s, memory_mb = time.monotonic(), processes.resident_mb()
        while time.monotonic() - begun_s < seconds:
            await asyncio.sleep(0.5)
            memory_mb = {name: max(mb, memory_mb[name]) for name, mb in processes.resident_mb().items()}
        on_time = film_bytes(sessions) / (time.monotonic() - begun_s)
        output = await asyncio.to_thread(lambda: taking.communicate(timeout=AFTER_S)[0])
        late_s = time.monotonic() - begun_s - seconds
        used = {name: value - at_rest[name] for name, value in processes.cpu_s().items()}
    finally:
        loading.close()
        processes.close()
    session = Session.open(Path(json.loads(output)["session"]))
    manifest = session.manifest
    frames = len(manifest.images)
    idle = {name: (value - before[name]) / IDLE_S for name, value in at_rest.items()}
    return {
        "receiver": "simulshot, open" if is_open else "simulshot",
        "mb_per_s": on_time / 1e6,
        "late_s": late_s,
        "frames": frames,
        "missing": len(manifest.missing),
        "reasons": sorted({gap.reason for gap in manifest.missing}),
        "instants": len(manifest.burst.instants_ns),
        "cpu_s_per_1000": {
            "receiver": 1000 * of_kind(used, leader=True) / frames,
            "senders": 1000 * of_kind(used, leader=False) / frames,
        },
        "at_rest_cpu_s_per_1000": {
            "receiver": 1000 * of_kind(idle, leader=True) / (cameras * fps),
            "senders": 1000 * of_kind(idle, leader=False) / (cameras * fps),
        },
        "memory_mb": {
            "receiver": of_kind(memory_mb, leader=True),
            "senders": of_kind(memory_mb, leader=False) / cameras,
        },
        "problems": [str(problem) for problem in verify(session)],
    }


def used_s(work: Callable[[], Any]) -> float:
    """Return the processor time that the child processes of `work` have used, s."""
    before = os.times()
    work()
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def by_ffmpeg(folder: Path, film: Path, cameras: int, fps: float, seconds: float, port: int) -> Report:
    """Send the JPEGs with `ffmpeg -c copy` over TCP, in real time, into a file for each camera."""
    quiet = ("ffmpeg", "-nostdin", "-loglevel", "fatal", "-y")
    reading = ("-re", "-stream_loop", "-1", "-framerate", f"{fps:g}", "-f", "mjpeg", "-i", str(film))
    receivers, senders = [], []
    for number in range(cameras):
        url = f"tcp://127.0.0.1:{port + number}"
        out = folder / f"ffmpeg{number}.mjpeg"
        receivers.append(
            subprocess.Popen(
                [*quiet, "-f", "mjpeg", "-i", f"{url}?listen", "-c", "copy", "-f", "mjpeg", str(out)]
            )
        )
    time.sleep(1.0)
    begun_s = time.monotonic()
    for number in range(cameras):
        url = f"tcp://127.0.0.1:{port + number}"
        senders.append(
            subprocess.Popen([*quiet, *reading, "-t", f"{seconds:g}", "-c", "copy", "-f", "mjpeg", url])
        )
    sending_s = used_s(lambda: [process.wait() for process in senders])
    took_s = time.monotonic() - begun_s
    receiving_s = used_s(lambda: [process.wait() for process in receivers])
    total = sum((folder / f"ffmpeg{number}.mjpeg").stat().st_size for number in range(cameras))
    frames = total / (film.stat().st_size / len(json.loads(film.with_suffix(".json").read_text())["lengths"]))
    return _of_another("ffmpeg -c copy", total / took_s, frames, receiving_s, sending_s)


def by_socket(
    folder: Path, images: Sequence[bytes], cameras: int, fps: float, seconds: float, port: int
) -> Report:
    """Send the JPEGs over plain sockets in real time into files, each synced each second."""
    receiver = os.fork()
    if not receiver:
        _receive(folder, cameras, port)
        os._exit(0)
    time.sleep(0.5)
    begun_s, senders = time.monotonic(), []
    for _ in range(cameras):
        if not (sender := os.fork()):
            _send(images, fps, seconds, port)
            os._exit(0)
        senders.append(sender)
    sending_s = used_s(lambda: [os.waitpid(pid, 0) for pid in senders])
    took_s = time.monotonic() - begun_s
    receiving_s = used_s(lambda: os.waitpid(receiver, 0))
    total = sum((folder / f"socket{number}.mjpeg").stat().st_size for number in range(cameras))
    frames = total / (sum(map(len, images)) / len(images))
    return _of_another("a Python socket", total / took_s, frames, receiving_s, sending_s)


def _receive(folder: Path, cameras: int, port: int) -> None:
    def write(connection: socket.socket, path: Path) -> None:
        buffer, synced_s = memoryview(bytearray(1 << 20)), time.monotonic()
        with path.open("wb", buffering=0) as film:
            while size := connection.recv_into(buffer):
                film.write(buffer[:size])
                if time.monotonic() - synced_s > 1:
                    os.fdatasync(film.fileno())
                    synced_s = time.monotonic()
            os.fdatasync(film.fileno())

    threads = []
    with socket.create_server(("127.0.0.1", port)) as server:
        for number in range(cameras):
            threads.append(
                threading.Thread(target=write, args=(server.accept()[0], folder / f"socket{number}.mjpeg"))
            )
            threads[-1].start()
        for thread in threads:
            thread.join()


def _send(images: Sequence[bytes], fps: float, seconds: float, port: int) -> None:
    with socket.create_connection(("127.0.0.1", port)) as connection:
        begun_s = time.monotonic()
        for number in range(round(seconds * fps)):
            time.sleep(max(0.0, begun_s + number / fps - time.monotonic()))
            connection.sendall(images[number % len(images)])


def _of_another(name: str, rate: float, frames: float, receiving_s: float, sending_s: float) -> Report:
    return {
        "receiver": name,
        "mb_per_s": rate / 1e6,
        "late_s": None,
        "frames": round(frames),
        "cpu_s_per_1000": {"receiver": 1000 * receiving_s / frames, "senders": 1000 * sending_s / frames},
    }


@contextlib.contextmanager
def busy(processes: int) -> Iterator[None]:
    """Keep this machine busy with so many processes."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def measure(options: argparse.Namespace, folder: Path) -> Report:
    """Measure each rig, beside ffmpeg and a plain socket."""
    report: Report = {"cores": len(os.sched_getaffinity(0)), "load": options.load, "rigs": {}}
    port = options.port
    for rig in options.rig or ["8x60", "4x30"]:
        cameras, fps = int(rig.partition("x")[0]), float(rig.partition("x")[2].partition("@")[0])
        size = SIZES[rig.partition("@")[2]]
        images, film = pictures(*size), folder / f"{rig}.mjpeg"
        write_film(film, size, images)
        mean_bytes = sum(map(len, images)) // len(images)
        rows = []
        others = [] if options.only else [by_socket, *([by_ffmpeg] if shutil.which("ffmpeg") else [])]
        for is_open in (False, True) if options.open else (False,):
            place = Path(tempfile.mkdtemp(dir=folder))
            # For this process and all that it starts.
            os.environ[OPEN_VARIABLE] = str(int(is_open))
            recording = record(
                place, film, cameras, fps, options.seconds, port, load=options.load, is_open=is_open
            )
            rows.append(asyncio.run(recording))
            talk(f"{rig}: {rows[-1]}")
            shutil.rmtree(place)
            port += 1
        for work in others:
            place, data = Path(tempfile.mkdtemp(dir=folder)), film if work is by_ffmpeg else images
            with busy(options.load):
                rows.append(work(place, data, cameras, fps, options.seconds, port))  # type: ignore[operator]
            shutil.rmtree(place)
            port += cameras
        film.unlink()
        report["rigs"][rig] = {
            "image_bytes": mean_bytes,
            "offered_mb_per_s": cameras * fps * mean_bytes / 1e6,
            "rows": rows,
        }
    return report


def print_tables(report: Report) -> None:
    """Print a report as tables."""
    kinds = ("receiver", "senders")
    print(f"everything on {report['cores']} cores, beside {report['load']} busy processes")
    for rig, of in report["rigs"].items():
        print(
            f"\n{rig}: {of['offered_mb_per_s']:.0f} MB/s offered, images of {of['image_bytes'] / 1000:.0f} kB"
        )
        rows = []
        for row in of["rows"]:
            cpu, memory = row["cpu_s_per_1000"], row.get("memory_mb", {})
            at_rest = row.get("at_rest_cpu_s_per_1000", {})
            rows.append([
                row["receiver"],
                f"{row['mb_per_s']:.0f}",
                "" if row["late_s"] is None else f"{row['late_s']:.1f}",
                str(row["frames"]),
                str(row.get("missing", "")),
                *(f"{used[kind]:.2f}" if used else "" for kind in kinds for used in (cpu, at_rest)),
                *(f"{memory[kind]:.0f}" if memory else "" for kind in kinds),
            ])  # fmt: skip
        columns = ["", "MB/s on time", "s late", "frames", "missing"]
        of_cpu = ["CPU-s/1,000: leader", "at rest", "nodes", "at rest"]
        print_table([*columns, *of_cpu, "MB: leader", "a node"], rows)
        for row in of["rows"]:
            if problems := row.get("problems"):
                print(f"verify: {problems[:3]}")


def main() -> None:
    """Read the options, measure and print."""
    parser = new_parser(__doc__)
    parser.add_argument("--rig", action="append", help="CAMERASxFPS; may be given again")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--load", type=int, default=0, help="busy processes beside the recording")
    parser.add_argument("--open", action="store_true", help="measure an open rig, without TLS, too")
    parser.add_argument("--only", action="store_true", help="simulshot alone, without ffmpeg and a socket")
    parser.add_argument("--port", type=int, default=47841)
    parser.add_argument(
        "--dir", type=Path, default=None, help="where to work, instead of the temporary folder"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.dir) as folder:
        report = measure(options, Path(folder))
    print_report(report, print_tables, as_json=options.json)


if __name__ == "__main__":
    main()
