"""Segments of sound with bytes and numbers that anyone may write: no traceback, and no memory for them."""

import random
import tracemalloc
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import SimulshotError
from capture_app.plugins.cameras.sound.image_sound import SoundPart, add_segments, sound_segments, sounds_of
from capture_app.plugins.programs.mp4 import mp4_sound

JPEG = cv2.imencode(".jpg", np.full((24, 32, 3), 90, np.uint8))[1].tobytes()
BEGIN_NS, PERIOD_NS, IMAGES = 10**12, 33_333_333, 6
NUMBERS = (0, 1, 7_999, 2**31 - 1, 2**31, 2**32 - 1, 2**53 - 1, 2**53, 2**63 - 1, 2**63, 2**64 - 1)
TIMES_NS = (0, -1, -(2**63), 2**31, 2**62, 2**63 - 1, BEGIN_NS - 10**9, BEGIN_NS + 10**9)
CASES, MAX_BYTES = 5_000, 100_000_000


def lying_part(rng: random.Random, number: int) -> SoundPart:
    """A part of a microphone's run whose numbers may be anything that fits into their fields."""
    true = SoundPart(1, number * 1600, 48_000, 1, BEGIN_NS + number * PERIOD_NS, rng.randbytes(3200))
    lies: dict[str, Any] = {
        "stream": rng.choice(NUMBERS) % 2**32,
        "first": rng.choice(NUMBERS),
        "rate_hz": rng.choice((0, 1, 8_000, 192_000, 192_001, 2**31, 2**32 - 1)),
        "channels": rng.choice((0, 1, 2, 3, 255)),
        "local_ns": rng.choice(TIMES_NS),
        "pcm": rng.randbytes(rng.choice((0, 1, 2, 3, 5, 4_000, 65_000))),
    }
    return true._replace(
        **{name: lies[name] for name in rng.sample(sorted(lies), rng.choice((0, 0, 1, 1, 2)))}
    )


def lying_image(rng: random.Random, number: int) -> bytes:
    """A JPEG with a part or two of sound, some bytes of which are changed, removed or added."""
    parts = [lying_part(rng, number) for _ in range(rng.choice((1, 1, 2)))]
    data = bytearray(add_segments(JPEG, sound_segments(parts)))
    for _ in range(rng.choice((0, 0, 0, 1, 3))):
        at = rng.randrange(60)
        data[at : at + rng.choice((0, 1, 4))] = rng.randbytes(rng.choice((0, 1, 4)))
    return bytes(data)


def test_no_segment_of_sound_breaks_an_export(monkeypatch: pytest.MonkeyPatch) -> None:
    muxed: list[int] = []
    found: list[Any] = []
    plugin = SimpleNamespace(read_sounds=lambda session, camera: found)
    monkeypatch.setattr(
        mp4_sound, "_mux", lambda video, blocks, channels: muxed.append(sum(1 for _ in blocks))
    )
    monkeypatch.setattr(mp4_sound, "load_plugins", lambda group, name: {"sound": plugin})
    tracemalloc.start()
    for seed in range(CASES):
        rng = random.Random(seed)
        times_ns = [rng.choice((BEGIN_NS + k * PERIOD_NS, *TIMES_NS)) for k in range(IMAGES)]
        if rng.random() < 0.7:
            times_ns = [BEGIN_NS + k * PERIOD_NS for k in range(IMAGES)]
        images = [
            SimpleNamespace(local_ns=local_ns, leader_ns=BEGIN_NS + k * PERIOD_NS)
            for k, local_ns in enumerate(times_ns)
        ]
        found = [(image, part) for k, image in enumerate(images) for part in sounds_of(lying_image(rng, k))]
        burst = SimpleNamespace(
            session=None,
            origin_ns=BEGIN_NS,
            period_ns=PERIOD_NS,
            images_of=lambda camera, images=images: images,
            warn=lambda line: None,
        )
        try:
            mp4_sound.add_own_sound(burst, "a", SimpleNamespace(), wav=False)  # type: ignore[arg-type]
        except SimulshotError:
            continue
        except Exception as error:
            raise AssertionError(f"seed {seed}: {error!r}") from error
    assert tracemalloc.get_traced_memory()[1] < MAX_BYTES
    assert len(muxed) > CASES / 2
