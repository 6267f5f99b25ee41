"""The two processes that `session_write.py` lets a session be transferred between, over loopback.

python -m benchmarks.sessions.session_transfer lead ROOT CAMERAS INSTANTS          take one burst
python -m benchmarks.sessions.session_transfer send FOLDER PORT CAMERAS INSTANTS   upload its images
"""

import asyncio
import json
import os
import resource
import sys
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from benchmarks.sessions.slow_disk import SlowDisk
from capture_app.cameras.frames import CapturedFrame
from capture_app.common.address import Address
from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.net.server import TransferServer, bind_port
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.burst.intake import DiskThreads
from capture_app.node.camera.burst_upload import BurstUpload, Spool
from capture_app.node.camera.uploader import Uploader
from capture_app.node.leader.service import LeaderService
from capture_app.protocol.messages import CameraReport, SpoolSpace, ToLeader
from capture_app.protocol.news import Log
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import Burst, SelectedFrame

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


def slow_disk() -> SlowDisk:
    """The disk that SYNC_MS and ONE_BY_ONE ask for, else one that only counts."""
    return SlowDisk(float(os.environ.get("SYNC_MS", "0")), one_by_one="ONE_BY_ONE" in os.environ)


def names(cameras: int) -> list[str]:
    """Return the cameras' names."""
    return [f"cam{number:02d}" for number in range(cameras)]


def instants_ns(instants: int) -> tuple[int, ...]:
    """Return the burst's instants, in the leader's time in ns."""
    return tuple(10**9 + PERIOD_NS * number for number in range(instants))


class OneBurst:
    """The bursts of a leader that has ordered one; its engine, and its options, too."""

    def __init__(self, session: BurstSession) -> None:
        self._session = session
        self.roster = self
        self.sessions = Path()
        self.members = {name: Joined(name) for name in session.burst.clients}
        self.news = Log()

    def now_ns(self) -> int:
        """The host's clock."""
        return time.monotonic_ns()

    async def find_session(self, report: CameraReport, pin: str) -> BurstSession:
        """The one burst."""
        return self._session

    def tell_progress(self, session: BurstSession) -> None:
        """Nobody listens."""

    def note_spool_space(self, space: SpoolSpace) -> None:
        """Nobody listens."""


@dataclass(frozen=True)
class Joined:
    """A node as its leader knows it, by a run that is 1."""

    name: str
    instance: int = 1
    principal: None = None


async def lead(root: Path, cameras: int, instants: int) -> None:
    """The leader's process: print its port, take the burst, and print the peak of its memory."""
    cameras_of_burst = names(cameras)
    times_ns = instants_ns(instants)
    burst = Burst(1, times_ns, PERIOD_NS, times_ns[0], tuple(cameras_of_burst))
    disk = slow_disk()
    writer = SessionWriter.create(root, "received")
    threads = DiskThreads()
    session = BurstSession.begin(burst, dict.fromkeys(cameras_of_burst, CAMERA), writer, threads)
    await session.write_plan(1)
    datagrams, listening = bind_port("127.0.0.1", 0)
    datagrams.close()
    nobody: Any = None
    one = cast(Any, OneBurst(session))
    service = LeaderService(one, one, nobody, nobody, one, None, nobody, nobody)
    server: TransferServer[ToLeader] = TransferServer(ToLeader, service.serve)
    await server.start(listening)
    print(listening.getsockname()[1], flush=True)
    await session.finished.wait()
    # Not ru_maxrss: that of a child begins with its parent's.
    status = await asyncio.to_thread(Path("/proc/self/status").read_text)
    peak_kb = int(status.split("VmHWM:")[1].split()[0])
    usage = resource.getrusage(resource.RUSAGE_SELF)
    told = {"peak_kb": peak_kb, "cpu_s": usage.ru_utime + usage.ru_stime, "syncs": disk.syncs}
    print(json.dumps(told), flush=True)
    await asyncio.sleep(0.2)
    await server.stop()
    threads.close()


@dataclass(frozen=True)
class FromFile:
    """A frame whose picture is a file's bytes."""

    file: Path

    @property
    def held_bytes(self) -> int:
        """None: it lies on the disk."""
        return 0

    def encode(self) -> bytes:
        """The picture."""
        return self.file.read_bytes()

    def reduced(self, width: int) -> NDArray[np.uint8]:
        """Not asked for here."""
        raise NotImplementedError


async def send(source: Path, port: int, cameras: int, instants: int) -> None:
    """The nodes' process: one uploader a camera, with a spool where SPOOL names a folder."""
    disk = slow_disk()
    times_ns = instants_ns(instants)
    uploaders = []
    for name in names(cameras):
        picks = deque(
            SelectedFrame(
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
        camera = CameraRecord(name=name, facts=CAMERA)
        plan = CameraPlan(camera=camera, reported=True, instants=tuple(range(instants)))
        report = CameraReport(leader=1, burst=1, plan=plan)
        spool = Spool(Path(os.environ["SPOOL"]), name) if "SPOOL" in os.environ else None
        uploader = Uploader(name, 1, Log(lambda line: print(line, file=sys.stderr)), spool)
        uploader.load_spool()
        uploader.add_burst(BurstUpload(report, picks))
        uploader.set_leader(Address("127.0.0.1", port))
        uploaders.append(uploader)
    tasks = [asyncio.create_task(uploader.run()) for uploader in uploaders]
    await asyncio.to_thread(sys.stdin.readline)
    print(disk.syncs, flush=True)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


if __name__ == "__main__":
    role, folder, *numbers = sys.argv[1:]
    asyncio.run((lead if role == "lead" else send)(Path(folder), *map(int, numbers)))
