"""A recording of some frames."""

import hashlib

from capture_app.session.format.manifest import BurstRecord, ImageRecord, MissingImage, image_path
from capture_app.session.reading.reader import Session
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import INSTANTS, camera_record, jpeg, local_from_leader


def frame(camera: str, instant: int, data: bytes = b"") -> StoredImage:
    """A frame 4 us after its instant, of other data if given."""
    data, leader_ns = data or jpeg(instant, 32, 24), INSTANTS[instant] + 4_000
    record = ImageRecord(
        camera=camera,
        instant=instant,
        path=image_path(camera, instant),
        leader_ns=leader_ns,
        local_ns=local_from_leader(leader_ns),
        residual_ns=4_000,
        uncertainty_ns=20_000,
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
    )
    return StoredImage(record, data, true_ns=instant + 5)


def save_frames(writer: SessionWriter, *frames: StoredImage) -> None:
    """Add frames to their videos, and see that all are there."""
    writer.save(frames, in_videos=True)
    assert all(writer.videos.has(*frame.key) for frame in frames)


def record(writer: SessionWriter) -> Session:
    """Two cameras, of which the right one drops its last frame."""
    for instant in range(3):
        save_frames(writer, frame("left", instant))
    save_frames(writer, frame("right", 0), frame("right", 1))
    return writer.finish(
        [camera_record("left", width=32, height=24), camera_record("right", width=32, height=24)],
        BurstRecord(instants_ns=INSTANTS, period_ns=33_000_000),
        [MissingImage(camera="right", instant=2, reason="the camera dropped the frame", dropped=True)],
        origin="simulated",
    )
