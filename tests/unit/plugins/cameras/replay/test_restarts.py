"""A recorded video as a camera that is restarted while a thread still reads its last picture."""

import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import open_camera
from capture_app.common.clock import HostClock
from capture_app.plugins.cameras.replay.recordings import SourceRecording
from capture_app.sync.wire.camera_commands import RestartStream
from tests.waiting import until


async def test_a_restart_during_a_read_plays_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its node stayed "aligning ... measuring after 1 correction": the stream had ended without a word."""
    video = cv2.VideoWriter(str(tmp_path / "cam.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 100.0, (64, 48))
    for number in range(4):
        video.write(np.full((48, 64, 3), 50 * number, np.uint8))
    video.release()
    camera = open_camera(f"replay:{tmp_path}/cam.avi", clock=HostClock(), name="cam")
    recording = camera._recording  # type: ignore[attr-defined]
    assert isinstance(recording, SourceRecording)
    source, reading, may_go_on = recording._source, threading.Event(), threading.Event()
    read = type(source).frames

    def slow(self: object, wanted: list[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        for number, frame in enumerate(read(source, wanted)):
            if number:
                reading.set()
                may_go_on.wait(10)
            yield frame

    frames: list[CapturedFrame] = []
    failures: list[Exception] = []
    monkeypatch.setattr(type(source), "frames", slow)
    await camera.start(frames.append, failures.append)
    await until(reading.is_set)
    await camera.apply(RestartStream(0))
    threading.Timer(0.1, may_go_on.set).start()
    await until(lambda: [frame.stream for frame in frames].count(1) >= 3 or failures)
    await camera.stop()
    assert not failures
