"""Sound that images carried, in exported MP4s: in step at both ends of ten minutes."""

import hashlib
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from capture_app.common.clock import SimulatedClock
from capture_app.companions.exporting.export_session import export_session
from capture_app.plugins.cameras.sound.image_sound import add_segments
from capture_app.plugins.cameras.sound.sound_ring import SoundRing
from capture_app.session.format.manifest import (
    BurstRecord,
    CameraRecord,
    ImageRecord,
    MissingImage,
    image_path,
)
from capture_app.session.reading.reader import Session
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from tests.facts import make_facts
from tests.unit.plugins.cameras.sound.arrivals import BEGIN_NS, arrivals

LENGTH_S, PERIOD_NS = 600, 800_000_000
CLOCK = SimulatedClock(offset_ns=3_600_000_000_123, skew_ppm=-40.0)
"""The node's clock; the true time is the leader's."""
DROPPED = 300
JPEG = cv2.imencode(".jpg", np.full((24, 32, 3), 90, np.uint8))[1].tobytes()


def recorded(folder: Path, length_s: float, *, restarted_at_s: float = 1e9) -> Session:
    """A video of a camera whose microphone begins a second before it, and loses samples in the middle.

    `restarted_at_s`: its node is killed then, and back after two seconds.
    """
    writer, ring, frames = SessionWriter.create(folder, "take"), SoundRing(), []
    times_ns = range(BEGIN_NS + 1_000_000_000, BEGIN_NS + round((length_s + 1) * 1e9), PERIOD_NS)
    waiting, down_ns = list(enumerate(times_ns)), round(BEGIN_NS + restarted_at_s * 1e9)
    lost_s = (length_s / 2 + 0.5, length_s / 2 + 0.9)
    for pcm, arrival_ns in arrivals(length_s + 2, lost_s=lost_s, stalls_s=((60.0, 60.9),)):
        if down_ns <= arrival_ns < down_ns + 2_000_000_000:
            ring = SoundRing()
            continue
        ring.add(pcm, CLOCK.local_from_true(arrival_ns))
        # Three frames at a time are encoded, in the wrong order.
        while len(waiting) > 2 and waiting[2][1] < arrival_ns:
            frames += [stored(n, at_ns, ring) for n, at_ns in (waiting[1], waiting[0], waiting[2])]
            del waiting[:3]
    frames += [stored(n, at_ns, ring) for n, at_ns in waiting]
    alive = [
        frame
        for frame in frames
        if frame.record.instant != DROPPED and not 0 <= frame.record.leader_ns - down_ns < 2_000_000_000
    ]
    writer.save(sorted(alive, key=lambda frame: frame.record.instant), in_videos=True)
    here = {frame.record.instant for frame in alive}
    return writer.finish(
        [CameraRecord(name="a", facts=make_facts(width=32, height=24, period_ns=PERIOD_NS))],
        BurstRecord(instants_ns=tuple(times_ns), period_ns=PERIOD_NS),
        [MissingImage(camera="a", instant=n, reason="gone") for n in range(len(times_ns)) if n not in here],
        origin="simulated",
    )


def stored(number: int, at_ns: int, ring: SoundRing) -> StoredImage:
    """A frame; one that is dropped is not encoded."""
    local_ns = CLOCK.local_from_true(at_ns)
    data = JPEG if number == DROPPED else add_segments(JPEG, ring.carry(local_ns))
    record = ImageRecord(
        camera="a",
        instant=number,
        path=image_path("a", number),
        leader_ns=at_ns,
        local_ns=local_ns,
        uncertainty_ns=20_000,
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
    )
    return StoredImage(record, data)


def test_a_camera_without_sound_has_a_silent_video_and_no_wav(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SoundRing, "carry", lambda *_: b"")
    session = recorded(tmp_path / "sessions", 3.0)
    export_session(session, "mp4", tmp_path / "out", wav=True)
    assert {path.name for path in (tmp_path / "out").iterdir() if path.suffix != ".csv"} == {
        "a.mp4",
        "simulshot.json",
    }
    with av.open(str(tmp_path / "out" / "a.mp4")) as container:
        assert not container.streams.audio
