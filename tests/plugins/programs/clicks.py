"""Clicks in the sound of a video."""

from pathlib import Path

import av
import numpy as np


def clicks_of(path: Path) -> list[float]:
    """The times in s of the clicks in a video's sound."""
    with av.open(str(path)) as container:
        parts = [
            (float(frame.pts * frame.time_base), frame.rate, np.abs(frame.to_ndarray()[0]))
            for frame in container.decode(container.streams.audio[0])
        ]
    loud_s = np.concatenate([at_s + np.flatnonzero(part > 0.3) / rate for at_s, rate, part in parts])
    return [float(run.mean()) for run in np.split(loud_s, np.flatnonzero(np.diff(loud_s) > 0.1) + 1)]
