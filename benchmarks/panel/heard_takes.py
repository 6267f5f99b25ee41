"""Sound tracks of random takes: what the cameras' microphones hear while the panel would be shown."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import av
import numpy as np

from benchmarks.panel.recorded_takes import MARGIN_S, VISIT_S, Camera
from capture_app.companions.panel.finder import Floats
from capture_app.plugins.footage.sound import RATE_HZ

CLAPS, APART_S = 3, (0.15, 0.33)
"""Claps of a visit, and range of the times between them: not in time, as of a hand."""
AROUND_S = 3.0
"""Mean time between a room's other sounds, which are 3 to 20 times weaker."""
DISTANCES_M, DELAYS_S = (0.5, 1.5), (0.0, 0.02)
"""Ranges of a microphone's distance from the claps, and of the time by which a camera's sound is late."""
SOUND_M_PER_S = 343.0
NOISE = 0.01
"""Standard deviation of a microphone's noise, against a clap of about 1."""
RINGING_S = 0.02


def record_sound(camera: Camera, path: Path, late_s: float, rng: np.random.Generator) -> None:
    """Write what a camera hears, late by `late_s` against its images, as WAV."""
    length = round((camera.own_s(camera.visits_s[-1]) + VISIT_S + MARGIN_S) * RATE_HZ)
    heard = rng.normal(0, NOISE, length).astype(np.float32)
    for at_s, strength, number in _sounds(camera.visits_s):
        begin = int(camera.own_s(at_s) * RATE_HZ)
        at = np.arange(max(begin, 0), min(begin + RATE_HZ // 4, length))
        since_s = at / RATE_HZ / (1 + camera.ppm * 1e-6) + camera.start_s - at_s - late_s
        heard[at] += strength * _clap(since_s, np.random.default_rng(number))
    with av.open(str(path), "w", format="wav") as container:
        track = container.add_stream("pcm_s16le", rate=RATE_HZ, layout="mono")
        levels = np.clip(heard * 8_000, -32_768, 32_767).astype(np.int16)
        frame = av.AudioFrame.from_ndarray(levels[None], format="s16", layout="mono")
        frame.sample_rate = RATE_HZ
        container.mux(track.encode(frame))
        container.mux(track.encode(None))


def _sounds(visits_s: Sequence[float]) -> Iterator[tuple[float, float, int]]:
    """Yield true times (s) and strengths of a room's sounds, and numbers by which they differ."""
    rng = np.random.default_rng(round(1000 * visits_s[0]))
    count = round((visits_s[-1] - visits_s[0] + VISIT_S) / AROUND_S)
    for number in range(count):
        yield float(rng.uniform(visits_s[0], visits_s[-1] + VISIT_S)), float(rng.uniform(0.05, 0.3)), number
    for place, visit_s in enumerate(visits_s):
        for clap, after_s in enumerate(np.cumsum(rng.uniform(*APART_S, CLAPS))):
            yield visit_s + float(after_s), 1.0, count + CLAPS * place + clap


def _clap(since_s: Floats, rng: np.random.Generator) -> Floats:
    """Return a clap's sound after it (s): tones of its own that ring out."""
    tones = zip(rng.uniform(400, 5000, 24), rng.uniform(0, 2 * np.pi, 24), strict=True)
    rings = sum(np.sin(2 * np.pi * hz * since_s + phase) for hz, phase in tones)
    return np.asarray(np.where(since_s > 0, rings * np.exp(-np.maximum(since_s, 0) / RINGING_S) / 12, 0))


def draw_lateness(seed: int, *, one_model: bool) -> tuple[tuple[float, float], float]:
    """Return how late two cameras' sounds are (s), and the most that an import expects between them.

    Cameras of one model hear equally late, distances aside.
    """
    rng = np.random.default_rng([seed, 11])
    way_s = rng.uniform(*DISTANCES_M, 2) / SOUND_M_PER_S
    delay_s = np.zeros(2) if one_model else rng.uniform(*DELAYS_S, 2)
    most_s = np.ptp(DISTANCES_M) / SOUND_M_PER_S + (0.0 if one_model else np.ptp(DELAYS_S))
    first, second = (way_s + delay_s).tolist()
    return (first, second), float(most_s)
