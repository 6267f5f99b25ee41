"""A burst of two instants, and spare ones, and what its cameras tell and send of it."""

import asyncio
import hashlib
from collections.abc import AsyncIterator, Collection
from pathlib import Path

from capture_app.common.camera_facts import PhaseControl
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.burst.intake import disk_threads
from capture_app.protocol.messages import CameraReport, ImageBatch, ImageUpload
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord, ImageRecord, MissingImage, image_path
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import Burst
from tests.facts import make_facts
from tests.images import small_jpeg

PERIOD_NS = 33_333_333
INSTANTS_NS = (1_000_000_000, 1_033_333_333)
LEADER = 77
DISK = disk_threads()
CAMERA = make_facts(kind="v4l2", model="Webcam", period_ns=PERIOD_NS, phase_control=PhaseControl.RESET)
IMAGE = small_jpeg(b"a picture of some length")


def burst_session(
    folder: Path,
    *names: str,
    spare: int = 0,
    short_timeouts: Collection[str] = (),
    kind: type[SessionWriter] = SessionWriter,
) -> BurstSession:
    """A burst of two instants, and so many spare ones; `short_timeouts` were silent in the burst before."""
    instants_ns = tuple(INSTANTS_NS[0] + PERIOD_NS * n for n in range(len(INSTANTS_NS) + spare))
    burst = Burst(1, instants_ns, PERIOD_NS, INSTANTS_NS[0], names, spare)
    writer, cameras = kind.create(folder, "burst-001"), dict.fromkeys(names, CAMERA)
    return BurstSession.begin(burst, cameras, writer, DISK, short_timeouts=short_timeouts)


def report(name: str, *instants: int, missing: tuple[MissingImage, ...] = ()) -> CameraReport:
    record = CameraRecord(name=name, facts=CAMERA)
    plan = CameraPlan(camera=record, reported=True, instants=instants, missing=missing)
    return CameraReport(leader=LEADER, burst=1, plan=plan)


def upload(name: str, instant: int) -> ImageUpload:
    record = ImageRecord(
        camera=name,
        instant=instant,
        path=image_path(name, instant),
        leader_ns=INSTANTS_NS[0] + PERIOD_NS * instant + 5,
        residual_ns=5,
        bytes=len(IMAGE),
        sha256=hashlib.sha256(IMAGE).hexdigest(),
    )
    return ImageUpload(leader=LEADER, burst=1, record=record)


async def receive_image(
    session: BurstSession, upload: ImageUpload, payload: AsyncIterator[bytes], now_ns: int = 0
) -> str:
    """Bring an image and wait until it is on disk, and the session where it was the last one."""
    sha256 = await asyncio.shield(await session.take(ImageBatch(images=(upload,)), payload, now_ns))
    await session.finish_if_complete()
    return sha256


async def pieces(data: bytes) -> AsyncIterator[bytes]:
    for begin in range(0, len(data), 5):
        yield data[begin : begin + 5]


def saved(session: BurstSession) -> Session:
    """The session of a burst that is finished."""
    assert session.session is not None
    return Session.open(session.session)
