"""Frames of a video as they come in: whole in memory, then added to their camera's video together."""

import asyncio
import hashlib
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import replace

from capture_app.errors import SimulshotError, TryAgainError
from capture_app.node.burst.camera_progress import CameraProgress
from capture_app.node.burst.image_commits import IncomingImage
from capture_app.node.wire.messages import ImageUpload
from capture_app.session.writing.received_image import ReceivedImage
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.session.writing.video_store import NewFrame
from capture_app.sync.rig.frame_picks import Burst


async def receive_frame(upload: ImageUpload, payload: AsyncIterator[bytes]) -> NewFrame:
    """Take a frame in. Raises TryAgainError where it is not what the upload tells, NetworkError."""
    data, record = b"".join([chunk async for chunk in payload]), upload.record
    whole = not upload.offset and not upload.truth_bytes and len(data) == record.bytes
    if not whole or hashlib.sha256(data).hexdigest() != record.sha256:
        raise TryAgainError(f"the frame of {record.camera} at instant {record.instant} arrived damaged")
    return NewFrame(record, data, upload.true_ns)


def add_images(writer: SessionWriter, images: Sequence[IncomingImage]) -> list[SimulshotError | None]:
    """Add images to a session, and frames to its videos; return what went wrong with each.

    Blocks on the disk, and for each camera's video once.
    """
    errors: dict[int, SimulshotError | None] = {}
    files = [(place, image) for place, image in enumerate(images) if isinstance(image, ReceivedImage)]
    if files:
        saved = writer.add_received([image for _, image in files])
        errors |= {place: error for (place, _), error in zip(files, saved, strict=True)}
    frames: dict[str, list[tuple[int, NewFrame]]] = {}
    for place, image in enumerate(images):
        if isinstance(image, NewFrame):
            frames.setdefault(image.record.camera, []).append((place, image))
    for new in frames.values():
        failure: SimulshotError | None = None
        try:
            writer.add_frames([frame for _, frame in new])
        except SimulshotError as error:
            failure = error
        errors |= dict.fromkeys((place for place, _ in new), failure)
    return [errors[place] for place in range(len(images))]


def shortened(burst: Burst, cameras: Mapping[str, CameraProgress]) -> Burst:
    """A recording as long as any of its cameras has recorded."""
    told = [of.report.picked or 0 for of in cameras.values() if of.report is not None]
    frames = max([1, *told, *(camera.instants.end for camera in cameras.values())])
    return replace(burst, instants_ns=burst.instants_ns[:frames])


def known_image(sha256: str) -> "asyncio.Future[str]":
    """The answer for an image that need not be saved."""
    done: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    done.set_result(sha256)
    return done


async def ignore_image(upload: ImageUpload, payload: AsyncIterator[bytes]) -> "asyncio.Future[str]":
    """Answer for an image of an instant that the burst does without."""
    async for _ in payload:
        pass
    return known_image(upload.record.sha256)
