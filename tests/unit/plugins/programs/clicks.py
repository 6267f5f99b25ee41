"""Clicks in the sound of a video, and of images."""

from collections.abc import Iterable
from pathlib import Path

import av
import numpy as np

from capture_app.plugins.cameras.sound.image_sound import SoundPart


def clicks_of(path: Path) -> list[float]:
    """The times in s of the clicks in a video's sound."""
    with av.open(str(path)) as container:
        parts = [
            (float(frame.pts * frame.time_base), frame.rate, np.abs(frame.to_ndarray()[0]))
            for frame in container.decode(container.streams.audio[0])
        ]
    loud_s = np.concatenate([at_s + np.flatnonzero(part > 0.3) / rate for at_s, rate, part in parts])
    return [float(run.mean()) for run in np.split(loud_s, np.flatnonzero(np.diff(loud_s) > 0.1) + 1)]


def click_errors_ms(parts: Iterable[SoundPart], *, louder_than: int = 0) -> list[float]:
    """How late each click in images' sound is: they are at whole seconds of the node's clock."""
    errors_ms = []
    for part in parts:
        loud = np.flatnonzero(np.abs(np.frombuffer(part.pcm, "<i2").astype(int)) > louder_than)
        if len(loud):
            at_ns = part.local_ns + int(loud[0]) * 1e9 / part.rate_hz
            errors_ms.append(((at_ns + 5e8) % 1e9 - 5e8) / 1e6)
    return errors_ms
