"""An uploader with pictures to send, and a leader on the loopback that answers as a test says."""

import asyncio
import hashlib
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.camera_facts import PhaseControl
from capture_app.net.channel import Channel
from capture_app.node.camera.burst_upload import Upload
from capture_app.node.camera.spool import Spool
from capture_app.node.camera.uploader import Uploader
from capture_app.protocol.log import Log
from capture_app.protocol.messages import (
    CameraReport,
    ImageAck,
    ImageBatch,
    ImageReceipt,
    ImageUpload,
    Refusal,
    ReportAck,
    ToLeader,
)
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.frame_selection import DROPPED, FramesSelected, Gap, SelectedFrame
from capture_app.sync.wire.datagrams import Trigger
from tests.facts import make_facts
from tests.unit.net.echoes import received_from, serving

CAMERA = make_facts(phase_control=PhaseControl.INJECTION)


@dataclass
class Picture:
    data: bytes
    encoded: int = 0

    @property
    def held_bytes(self) -> int:
        return len(self.data)

    def reduced(self, width: int) -> NDArray[np.uint8]:
        raise NotImplementedError

    def encode(self) -> bytes:
        self.encoded += 1
        if not self.data:
            raise RuntimeError("the film is torn")
        return self.data


def burst_upload(*pictures: Picture) -> Upload:
    picks = [
        SelectedFrame(n, 1000 + n, 2000 + n, 3, 4, 5, 0, CapturedFrame(n, 0, 1000 + n, picture))
        for n, picture in enumerate(pictures)
    ]
    camera = CameraRecord(name="a", facts=CAMERA)
    plan = CameraPlan(camera=camera, reported=True, instants=tuple(range(len(picks))))
    return Upload(CameraReport(leader=1, burst=1, plan=plan), deque(picks))


TIME_MAP = TimeMap(0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, samples=1, round_trip_ns=0)


def further(
    *frames: SelectedFrame[CapturedFrame], gaps: Sequence[int] = (), over: int = 0, ended: bool = False
) -> FramesSelected[CapturedFrame]:
    """What was picked of the burst after its beginning, and the instants whose frames the camera dropped.

    `over` instants are decided now, and with `ended` these are all.
    """
    trigger = Trigger(0, 1, 1, 0, 1, over if ended else over + 1, streamed=True)
    missing = tuple(Gap(instant, DROPPED) for instant in gaps)
    return FramesSelected(trigger, frames, missing, TIME_MAP, None, further=True, over=over)


Serve = Callable[[Channel[ToLeader]], Awaitable[None]]


async def images(
    channel: Channel[ToLeader],
    answer: Callable[[CameraReport], ReportAck | Refusal] = lambda _: ReportAck(),
    down: asyncio.Event | None = None,
) -> AsyncIterator[tuple[ImageUpload, bytes]]:
    """Answer what a stream tells, and yield its images; a batch is acknowledged after its last one."""
    while not (down and down.is_set()) and (received := await received_from(channel)) is not None:
        message, payload = received
        if isinstance(message, ImageBatch):
            for image in message.images:
                yield image, payload[: image.bytes]
                payload = payload[image.bytes :]
            await channel.send(ImageAck(sha256=message.sha256))
        else:
            await channel.send(answer(message) if isinstance(message, CameraReport) else ReportAck())


def receipts_of(stored: dict[int, bytes]) -> ReportAck:
    """What a leader has of a burst's images, all of them whole."""
    receipts = (
        ImageReceipt(instant=n, sha256=hashlib.sha256(data).hexdigest()) for n, data in stored.items()
    )
    return ReportAck(receipts=tuple(receipts))


@asynccontextmanager
async def uploading(
    serve: Serve, said: list[str], spool: Spool | None = None, retry_s: Sequence[float] = (0.0,)
) -> AsyncIterator[Uploader]:
    async with serving(serve, ToLeader) as leader:
        uploader = Uploader("a", 1, Log(said.append), spool, retry_s=retry_s)
        uploader.load_spool()
        uploader.set_leader(leader, 1)
        task = asyncio.create_task(uploader.run())
        try:
            yield uploader
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
            await uploader.aclose()
            if spool is not None:
                spool.close()
