"""How fast a session is written, beside `cp` and `sync` of the same bytes, and a leader's memory.

    python benchmarks/session_write.py [--cameras 20] [--instants 25] [--rounds 6] [--dir DIR] [--json]

Three ways in each round: `cp` of the images and `sync` of the disk; the session's writer, an image of each
camera at a time; and a leader's transfer server in a process of its own, fed over loopback by one stream
a camera from another process, from the first report to the manifest. Every session is verified.
"""

import argparse
import asyncio
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import AsyncGenerator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from capture_app.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.cameras.base import CapturedFrame
from capture_app.net.address import Address
from capture_app.net.server import TransferServer, bind_port
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.leader.service import LeaderService
from capture_app.node.transfer.burst_upload import BurstUpload
from capture_app.node.transfer.uploader import Uploader
from capture_app.node.wire.messages import BurstRequest, CameraReport, ImageUpload, SpoolSpace, ToLeader
from capture_app.node.wire.status import BurstStatus, RigStatus
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_picks import Burst, Pick

WIDTH, HEIGHT, PERIOD_NS = 1920, 1080, 33_333_333
CAMERA = CameraFacts(
    kind="benchmark",
    model="JPEG files",
    width=WIDTH,
    height=HEIGHT,
    period_ns=PERIOD_NS,
    phase_control=PhaseControl.NONE,
    timestamp_source=TimestampSource.START_OF_EXPOSURE,
)


def names(cameras: int) -> list[str]:
    """The cameras."""
    return [f"cam{number:02d}" for number in range(cameras)]


def instants_ns(instants: int) -> tuple[int, ...]:
    """The burst's instants."""
    return tuple(10**9 + PERIOD_NS * number for number in range(instants))


def make_images(folder: Path, cameras: int, instants: int) -> int:
    """Write pictures with the detail and noise of a camera's, each different; return their bytes."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 255, (HEIGHT // 24, WIDTH // 24, 3), np.uint8)
    scene = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC).astype(np.int16)
    total = 0
    for instant in range(instants):
        noise = rng.normal(0, 5, (HEIGHT, WIDTH, 3)).astype(np.int16)
        picture = np.clip(np.roll(scene, 7 * instant, axis=1) + noise, 0, 255).astype(np.uint8)
        data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()
        for number, name in enumerate(names(cameras)):
            (folder / name).mkdir(parents=True, exist_ok=True)
            # What follows the end of a JPEG is not shown: enough to make each file another one.
            (folder / name / f"{instant:06d}.jpg").write_bytes(data + number.to_bytes(2, "big"))
            total += len(data) + 2
    return total


def copy(source: Path, to: Path) -> float:
    """Seconds to copy all files and see them on the disk."""
    began_s = time.perf_counter()
    subprocess.run(["cp", "-r", str(source), str(to)], check=True)
    subprocess.run(["sync", "--file-system", str(to)], check=True)
    return time.perf_counter() - began_s


def write(images: dict[tuple[str, int], bytes], root: Path, cameras: int, instants: int) -> float:
    """Seconds from an empty folder to the manifest, with the images in memory."""
    times_ns = instants_ns(instants)
    began_s = time.perf_counter()
    writer = SessionWriter.create(root, "written")

    def add(of: tuple[str, int]) -> None:
        writer.add_image(images[of], camera=of[0], instant=of[1], leader_ns=times_ns[of[1]])

    with ThreadPoolExecutor(cameras) as pool:
        list(pool.map(add, sorted(images, key=lambda of: of[1])))
    writer.finish(
        [CameraRecord(name=name, facts=CAMERA) for name in names(cameras)],
        BurstRecord(instants_ns=times_ns, period_ns=PERIOD_NS),
    )
    return time.perf_counter() - began_s


class OneBurst:
    """A leader that has ordered one burst."""

    def __init__(self, session: BurstSession) -> None:
        self._session = session

    def now_ns(self) -> int:
        """The host's clock."""
        return time.monotonic_ns()

    def status(self) -> RigStatus:
        """Nobody asks."""
        raise NotImplementedError

    def take_burst(self, request: BurstRequest) -> AsyncGenerator[BurstStatus, None]:
        """Nobody asks."""
        raise NotImplementedError

    async def find_session(self, message: CameraReport | ImageUpload) -> BurstSession:
        """The one burst."""
        return self._session

    def tell_progress(self, session: BurstSession) -> None:
        """Nobody listens."""

    def note_spool_space(self, space: SpoolSpace) -> None:
        """Nobody listens."""


async def lead(root: Path, cameras: int, instants: int) -> None:
    """The leader's process: print its port, take the burst, and print the peak of its memory."""
    of = names(cameras)
    times_ns = instants_ns(instants)
    burst = Burst(1, times_ns, PERIOD_NS, times_ns[0], tuple(of))
    session = BurstSession(burst, dict.fromkeys(of, CAMERA), SessionWriter.create(root, "received"))
    await session.write_plan(1)
    datagrams, listening = bind_port("127.0.0.1", 0)
    datagrams.close()
    server: TransferServer[ToLeader] = TransferServer(ToLeader, LeaderService(OneBurst(session)).serve)
    await server.start(listening)
    print(listening.getsockname()[1], flush=True)
    await session.finished.wait()
    # Not ru_maxrss: that of a child begins with its parent's.
    status = await asyncio.to_thread(Path("/proc/self/status").read_text)
    peak_kb = int(status.split("VmHWM:")[1].split()[0])
    usage = resource.getrusage(resource.RUSAGE_SELF)
    told = {"peak_kb": peak_kb, "cpu_s": usage.ru_utime + usage.ru_stime}
    print(json.dumps(told), flush=True)
    await asyncio.sleep(0.2)
    await server.stop()


@dataclass(frozen=True)
class FromFile:
    """A frame whose picture is a file's bytes."""

    file: Path

    def encode(self) -> bytes:
        """The picture."""
        return self.file.read_bytes()


async def send(source: Path, port: int, cameras: int, instants: int) -> None:
    """The nodes' process: one uploader a camera."""
    times_ns = instants_ns(instants)
    uploaders = []
    for name in names(cameras):
        picks = deque(
            Pick(
                instant=n,
                local_ns=at_ns,
                leader_ns=at_ns,
                residual_ns=0,
                uncertainty_ns=1,
                hard_bound_ns=1,
                outlier_ns=0,
                frame=CapturedFrame(n, 0, at_ns, FromFile(source / name / f"{n:06d}.jpg")),
            )
            for n, at_ns in enumerate(times_ns)
        )
        report = CameraReport(
            leader=1, burst=1, camera=CameraRecord(name=name, facts=CAMERA), instants=tuple(range(instants))
        )
        uploader = Uploader(lambda line: print(line, file=sys.stderr))
        uploader.add_burst(BurstUpload(report, picks))
        uploader.set_leader(Address("127.0.0.1", port))
        uploaders.append(uploader)
    await asyncio.gather(*(uploader.run() for uploader in uploaders))


def receive(source: Path, root: Path, cameras: int, instants: int) -> tuple[float, dict[str, float]]:
    """Seconds from the first report to the manifest, and the leader's memory in kB and CPU time."""
    size = ["--cameras", str(cameras), "--instants", str(instants)]
    command = [sys.executable, __file__, *size]
    with subprocess.Popen([*command, "--lead", str(root)], stdout=subprocess.PIPE, text=True) as leader:
        assert leader.stdout is not None
        port = leader.stdout.readline().strip()
        began_s = time.perf_counter()
        with subprocess.Popen([*command, "--send", str(source), "--port", port]) as nodes:
            told = leader.stdout.readline()
            seconds = time.perf_counter() - began_s
            nodes.kill()
    return seconds, json.loads(told)


def measure(folder: Path, cameras: int, instants: int, rounds: int) -> dict[str, Any]:
    """All figures; every session is verified."""
    source = folder / "source"
    total = make_images(source, cameras, instants)
    images = {
        (name, number): (source / name / f"{number:06d}.jpg").read_bytes()
        for name in names(cameras)
        for number in range(instants)
    }
    os.sync()
    seconds: dict[str, list[float]] = {"copy": [], "write": [], "receive": []}
    peak_kb: list[float] = []
    cpu_s: list[float] = []
    for number in range(rounds):
        to = folder / "round"
        to.mkdir()
        # In another order each time: a disk may take what comes first faster than what comes last.
        for how in [*seconds][number % 3 :] + [*seconds][: number % 3]:
            if how == "copy":
                spent = copy(source, to / "copied")
            elif how == "write":
                spent = write(images, to, cameras, instants)
            else:
                spent, told = receive(source, to, cameras, instants)
                peak_kb.append(told["peak_kb"])
                cpu_s.append(told["cpu_s"])
            seconds[how].append(spent)
        for name in ("written", "received"):
            session = Session.open(to / name)
            problems = verify(session)
            if problems or len(session.manifest.images) != len(images):
                raise SystemExit(f"{name}: {problems[:3]}")
        shutil.rmtree(to)
    speed = {how: [total / 1e6 / spent for spent in of] for how, of in seconds.items()}
    ratios = [w / c for w, c in zip(speed["write"], speed["copy"], strict=True)]
    received = [r / c for r, c in zip(speed["receive"], speed["copy"], strict=True)]
    return {
        "images": len(images),
        "megabytes": round(total / 1e6, 1),
        "rounds": rounds,
        "copy_mb_per_s": round(statistics.median(speed["copy"]), 1),
        "write_mb_per_s": round(statistics.median(speed["write"]), 1),
        "receive_mb_per_s": round(statistics.median(speed["receive"]), 1),
        "write_to_copy": round(statistics.median(ratios), 2),
        "write_to_copy_worst": round(min(ratios), 2),
        "receive_to_copy": round(statistics.median(received), 2),
        "leader_peak_mb": round(max(peak_kb) / 1000, 1),
        "leader_cpu_s": round(statistics.median(cpu_s), 2),
    }


def main() -> None:
    """Read the options, measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cameras", type=int, default=20)
    parser.add_argument("--instants", type=int, default=25)
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument(
        "--dir", type=Path, help="a folder on the disk to measure; default: the temporary one"
    )
    parser.add_argument("--json", action="store_true", help="print JSON alone")
    parser.add_argument("--lead", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--send", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.lead:
        asyncio.run(lead(options.lead, options.cameras, options.instants))
    elif options.send:
        asyncio.run(send(options.send, options.port, options.cameras, options.instants))
    else:
        with tempfile.TemporaryDirectory(dir=options.dir) as folder:
            figures = measure(Path(folder), options.cameras, options.instants, options.rounds)
        if options.json:
            print(json.dumps(figures))
            return
        print(f"{figures['images']} images, {figures['megabytes']} MB, medians of {figures['rounds']} rounds")
        print(f"cp and sync                    {figures['copy_mb_per_s']:8.1f} MB/s")
        print(f"session written                {figures['write_mb_per_s']:8.1f} MB/s")
        print(f"session received over loopback {figures['receive_mb_per_s']:8.1f} MB/s")
        print(
            f"written / cp {figures['write_to_copy']:.2f} (worst {figures['write_to_copy_worst']:.2f}), "
            f"received / cp {figures['receive_to_copy']:.2f}"
        )
        print(f"leader's peak memory {figures['leader_peak_mb']:.0f} MB, CPU {figures['leader_cpu_s']:.1f} s")


if __name__ == "__main__":
    main()
