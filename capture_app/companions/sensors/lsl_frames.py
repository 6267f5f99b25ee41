"""Stream of a rig's frame times in the Lab Streaming Layer (LSL), read from its sessions' journals.

A sample has five strings: session, instant, camera, time in the leader's clock (s), and its error (s, 95 %;
empty if unknown). Its timestamp is the frame's time in LSL's clock of this machine, which puts it among the
samples of all other sensors. Samples come some time after their frames: once these are
on the leader's disk, each camera's in order.
"""

import asyncio
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from capture_app.common.clock import NodeClock
from capture_app.common.host_clock import host_ns
from capture_app.common.optional_packages import load_optional
from capture_app.common.tasks import end
from capture_app.node.burst.burst_session import BurstSession
from capture_app.session.format.journal import FRAMES_SUFFIX, record_of_line
from capture_app.session.format.manifest import JOURNAL, RIG, VIDEOS, FrameRecord, ImageRecord, video_of

STREAM, TYPE = "simulshot frames", "Markers"
CHANNELS = ("session", "instant", "camera", "leader_s", "error_s")
LOOK_EVERY_S = 0.1
READINGS = 5


class LslFrames:
    """Outlet of frame times between `start` and `close`."""

    def __init__(self) -> None:
        """Raises NotAvailableError if pylsl is missing or does not load."""
        self._lsl = load_optional("pylsl", "lsl", "the Lab Streaming Layer")
        self._takes: dict[BurstSession, _Tail] = {}
        self._task: asyncio.Task[None] | None = None
        self._clock: NodeClock
        self._outlet: Any = None

    def start(self, clock: NodeClock) -> None:
        """Open the stream, and follow each take from then on."""
        lsl = self._lsl
        info = lsl.StreamInfo(
            STREAM, TYPE, len(CHANNELS), lsl.IRREGULAR_RATE, "string", f"simulshot-{socket.gethostname()}"
        )
        channels = info.desc().append_child("channels")
        for label in CHANNELS:
            channels.append_child("channel").append_child_value("label", label)
        self._clock, self._outlet = clock, lsl.StreamOutlet(info)
        self._task = asyncio.create_task(self._run())

    def follow_take(self, take: BurstSession) -> None:
        """Follow a take's journals until it is saved."""
        self._takes[take] = _Tail()

    async def close(self) -> None:
        """Stream the last frames, and end the stream. Calling it twice is harmless."""
        if self._task is not None:
            await end(self._task)
            self._task = None
            self._stream_events()
            self._outlet = None

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            self._stream_events()

    def _stream_events(self) -> None:
        lsl_less_host_s = self._lsl_less_host_s()
        for take, tail in tuple(self._takes.items()):
            is_over, folder = take.finished.is_set(), take.folder
            for record in tail.new_records(folder):
                self._outlet.push_sample(
                    [
                        folder.name,
                        str(record.instant),
                        record.camera,
                        f"{record.leader_ns / 1e9:.9f}",
                        "" if record.uncertainty_ns is None else f"{record.uncertainty_ns / 1e9:.9f}",
                    ],
                    self._clock.true_from_local(record.leader_ns) / 1e9 + lsl_less_host_s,
                )
            if is_over:
                del self._takes[take]

    def _lsl_less_host_s(self) -> float:
        """Return the difference of LSL's clock and the host's, s, by the quickest of several readings."""
        readings = []
        for _ in range(READINGS):
            before_ns = host_ns()
            lsl_s = float(self._lsl.local_clock())
            after_ns = host_ns()
            readings.append((after_ns - before_ns, lsl_s - (before_ns + after_ns) / 2e9))
        return min(readings)[1]


class _Tail:
    """Reader of the lines that a session's journals have got since it was last asked."""

    def __init__(self) -> None:
        self._read: dict[str, int] = {}
        """Number of bytes read of each file, by its name."""

    def new_records(self, folder: Path) -> Iterator[ImageRecord]:
        """Yield the records of frames that are on disk since, of images and of videos.

        `folder` is the session's, which a person may have renamed meanwhile.
        """
        for line in self._new_lines(folder / JOURNAL):
            if (image := record_of_line(line, ImageRecord)) is not None:
                yield image
        videos = folder / VIDEOS / RIG
        for path in sorted(videos.glob(f"*{FRAMES_SUFFIX}")) if videos.is_dir() else ():
            camera, _ = video_of(path.name.removesuffix(FRAMES_SUFFIX))
            for line in self._new_lines(path):
                if (frame := record_of_line(line, FrameRecord)) is not None:
                    yield replace(frame, camera=camera)

    def _new_lines(self, path: Path) -> list[bytes]:
        try:
            with path.open("rb") as file:
                file.seek(self._read.get(path.name, 0))
                data = file.read()
        except OSError:
            return []  # not made yet, or the take was discarded
        whole = data[: data.rfind(b"\n") + 1]
        self._read[path.name] = self._read.get(path.name, 0) + len(whole)
        return whole.splitlines()
