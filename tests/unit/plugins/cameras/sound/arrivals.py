"""A microphone in virtual time: 100 ppm fast, with jitter, stalls and an overrun."""

import random
from collections.abc import Iterator

from capture_app.plugins.cameras.sound.microphones import SimulatedSound
from capture_app.plugins.cameras.sound.sound_ring import RATE_HZ

CHUNK = RATE_HZ // 25
DELAY_NS = 2_000_000
BEGIN_NS = 12_345_678_901


def arrivals(
    length_s: float,
    *,
    lost_s: tuple[float, float] = (0.0, 0.0),
    stalls_s: tuple[tuple[float, float], ...] = (),
    ppm: float = 100.0,
    begin_ns: int = BEGIN_NS,
    seed: int = 3,
) -> Iterator[tuple[bytes, int]]:
    """Samples from `begin_ns` of the true time on, and when they arrive.

    Samples within `lost_s` never do. During a stall nothing arrives, and at its end all at once.
    """
    rng, sound, last_ns = random.Random(seed), SimulatedSound(begin_ns, ppm), 0
    for first in range(0, round(length_s * RATE_HZ), CHUNK):
        due_ns = sound.true_ns(first + CHUNK) + DELAY_NS + round(rng.expovariate(1 / 1.5e6))
        for begin_s, end_s in stalls_s:
            if begin_ns + begin_s * 1e9 <= due_ns < begin_ns + end_s * 1e9:
                due_ns = begin_ns + round(end_s * 1e9)
        last_ns = max(due_ns, last_ns + 10_000)
        if not lost_s[0] <= first / RATE_HZ < lost_s[1]:
            yield sound.samples(first, CHUNK), last_ns
