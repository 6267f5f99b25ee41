"""A node whose camera is a film in memory: a driver's buffers, without a driver's cost.

    python -m benchmarks.sessions.memory_node FILM FPS LEADER NAME SPOOL

Its frames are those of a film that `write_film` wrote, over and over, with the jitter of a webcam's
timestamps. As with a driver, frames wait in as many buffers as the product asks of a driver, and further ones
are lost.
"""

import json
import random
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from capture_app.cameras.base import Camera, OnFailure, OnFrame, buffer_count
from capture_app.cameras.frame_reader import FrameReader
from capture_app.cameras.frames import CapturedFrame, JpegPicture
from capture_app.commands.shared_options import run_until_stopped
from capture_app.common import system
from capture_app.common.address import parse_address
from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.common.clock import HostClock
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.node_group import run_nodes
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.protocol.log import Log
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream
from capture_app.trust.trust import Trust

PICTURES, QUALITY = 60, 84
"""Number of different pictures of 1080p (fewer of larger ones), and their quality as JPEGs."""
JITTER_NS = 20_000
"""Standard deviation of the timestamps."""
DELIVERY_NS = 3_000_000
MAX_BUFFERS, MAX_BUFFER_BYTES = 32, 128 << 20
"""Limits of the driver for Video4Linux."""


def pictures(width: int, height: int) -> list[bytes]:
    """Return JPEGs with a camera's detail and noise."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 255, (height // 60, width // 60, 3), np.uint8)
    scene = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC).astype(np.int16)
    made = []
    for number in range(PICTURES * 1920 // width):
        noise = rng.normal(0, 4, (height, width, 3)).astype(np.int16)
        picture = np.clip(np.roll(scene, 7 * number, axis=1) + noise, 0, 255).astype(np.uint8)
        made.append(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes())
    return made


def write_film(path: Path, size: tuple[int, int], images: list[bytes]) -> None:
    """Write images and their size for `MemoryCamera`."""
    path.write_bytes(b"".join(images))
    lengths = [len(image) for image in images]
    path.with_suffix(".json").write_text(json.dumps({"size": size, "lengths": lengths}))


class MemoryCamera(Camera):
    """A webcam that is always in phase with the others of its machine."""

    def __init__(self, film: Path, fps: float) -> None:
        index = json.loads(film.with_suffix(".json").read_text())
        with film.open("rb") as file:
            self._pictures = [JpegPicture(file.read(length)) for length in index["lengths"]]
        self._period_ns = round(1e9 / fps)
        rng = random.Random(film.name)
        self._jitter_ns = [round(rng.gauss(0, JITTER_NS)) for _ in range(997)]
        self._facts = CameraFacts(
            kind="v4l2",
            model="Film in memory",
            width=index["size"][0],
            height=index["size"][1],
            period_ns=self._period_ns,
            timestamp_source=TimestampSource.START_OF_EXPOSURE,
            phase_control=PhaseControl.RESET,
        )
        frame_bytes = 2 * index["size"][0] * index["size"][1]
        self._buffers = buffer_count(
            frame_bytes, self._period_ns, max_count=MAX_BUFFERS, max_bytes=MAX_BUFFER_BYTES
        )
        self._stream, self._reader = -1, cast(FrameReader[CapturedFrame] | None, None)

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start streaming at the next whole period of the machine's clock."""
        self.listen(on_frame, on_failure)
        self._begin(-(-time.monotonic_ns() // self._period_ns) * self._period_ns)

    async def apply(self, command: CameraCommand) -> None:
        """Start again, at the time that is asked for."""
        assert isinstance(command, RestartStream)
        self._begin(time.monotonic_ns() + command.delay_ns)

    async def stop(self) -> None:
        """Stop streaming."""
        if self._reader is not None:
            self._reader.stop()

    def _begin(self, start_ns: int) -> None:
        if self._reader is not None:
            self._reader.stop()
            self._reader.join()
        self._start_ns, self._next, self._stream = start_ns, 0, self._stream + 1
        self._reader = FrameReader(
            self._read, self._on_frame, print, period_ns=self._period_ns, buffers=self._buffers
        )

    def _read(self) -> Iterator[CapturedFrame]:
        """Yield what is in the buffers; a driver without a free buffer has lost the newest frames."""
        newest = (time.monotonic_ns() - self._start_ns - DELIVERY_NS) // self._period_ns
        first, self._next = self._next, max(self._next, newest + 1)
        for number in range(first, min(newest + 1, first + self._buffers)):
            at_ns = self._start_ns + number * self._period_ns + self._jitter_ns[number % 997]
            yield CapturedFrame(number, self._stream, at_ns, self._pictures[number % len(self._pictures)])


def main() -> None:
    """Run the node until it is ended."""
    film, fps, leader, name, spool = sys.argv[1:]
    node = CameraNode(
        NodeOptions(
            name=name,
            open_camera=lambda: MemoryCamera(Path(film), float(fps)),
            leaders=(parse_address(leader),),
            clock=HostClock(),
            trust=Trust.of_user(),
            spool=Path(spool),
            log=Log(print),
        )
    )
    system.raise_thread_priority()
    system.reuse_freed_memory()
    run_until_stopped(run_nodes({name: node}, Log(print)))


if __name__ == "__main__":
    main()
