"""Takes of a scene in which a lamp blinks, by rolling shutters with tone curves of their own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.common.geometry import Array
from tests.facts import make_facts

PERIOD_NS = 33_333_000
FULL_WELL = 6000
MAINS_HZ = 100.0
TORCH_MS = 0.05
"""What an LED takes to light up."""
BULB_MS = 60.0


@dataclass(frozen=True)
class BlinkCamera:
    """A camera before the lamp; `late_ns` and what the session tells of it, where that is not true."""

    light: Sequence[Array]
    """What it sees without the lamp: linear light from 0 to 1, shown there and back."""
    row_time_ns: int
    exposure_ns: int
    late_ns: int = 0
    period_share: float = 0.0
    """Its frames are so much of a period later than the instants."""
    gamma: float = 1 / 2.2
    s_curve: float = 0.1
    quality: int = 88
    flicker: float = 0.03
    told_row_time_ns: int | None = None
    told_exposure_ns: int | None = None
    rows_untold: bool = False


@dataclass(frozen=True)
class Lamp:
    """A lamp that is on from each of `times_ms` for `lasts_ms`, as bright as `strength` (1: as the day)."""

    times_ms: tuple[float, ...]
    lasts_ms: float = 213.0
    strength: float = 1.0
    rise_ms: float = TORCH_MS

    def lit(self, start_ms: Array, exposure_ms: float) -> Array:
        """The mean light over exposures."""
        return np.asarray((self._integral(start_ms + exposure_ms) - self._integral(start_ms)) / exposure_ms)

    def _integral(self, at_ms: Array) -> Array:
        total = np.zeros_like(at_ms)
        for begin in self.times_ms:
            for edge, sign in ((begin, 1.0), (begin + self.lasts_ms, -1.0)):
                since = np.maximum(at_ms - edge, 0)
                # Light that comes and goes exponentially.
                total += sign * (since - self.rise_ms * (1 - np.exp(-since / self.rise_ms)))
        return total


def blink_times(rng: np.random.Generator, count: int = 8) -> tuple[float, ...]:
    """When somebody switches a torch on, ms."""
    return tuple(500 + np.cumsum(rng.uniform(550, 750, count)) - 550)


def write_blinks(
    root: Path, name: str, cameras: Mapping[str, BlinkCamera], lamp: Lamp, *, seed: int
) -> Session:
    """Its session, as long as the lamp blinks."""
    rng = np.random.default_rng(seed)
    writer = SessionWriter.create(root, name)
    count = int((lamp.times_ms[-1] + lamp.lasts_ms + 300) * 1e6 / PERIOD_NS)
    records = []
    for camera, of in cameras.items():
        height, width = of.light[0].shape
        falloff = _falloff(rng, height, width)
        turn = 2 * len(of.light) - 2
        for k in range(count):
            told_ns = k * PERIOD_NS + round(of.period_share * PERIOD_NS)
            rows_ms = (told_ns + of.late_ns) / 1e6 + np.arange(height) * of.row_time_ns / 1e6
            there = k % turn if turn else 0
            image = _expose(of, lamp, of.light[min(there, turn - there)], falloff, rows_ms, rng)
            exposure_ns = of.exposure_ns if of.told_exposure_ns is None else of.told_exposure_ns
            writer.add_image(
                cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, of.quality])[1].tobytes(),
                camera=camera,
                instant=k,
                leader_ns=told_ns,
                residual_ns=told_ns - k * PERIOD_NS,
                exposure_start_ns=None if of.rows_untold else told_ns,
                exposure_ns=None if of.rows_untold else exposure_ns,
            )
        row_ns = of.row_time_ns if of.told_row_time_ns is None else of.told_row_time_ns
        facts = make_facts(
            width=width,
            height=height,
            period_ns=PERIOD_NS,
            row_time_ns=None if of.rows_untold else row_ns,
        )
        records.append(CameraRecord(name=camera, facts=facts))
    instants = tuple(k * PERIOD_NS for k in range(count))
    burst = BurstRecord(instants_ns=instants, period_ns=PERIOD_NS)
    return writer.finish(records, burst, origin="simulated")


def _expose(
    of: BlinkCamera, lamp: Lamp, base: Array, falloff: Array, rows_ms: Array, rng: np.random.Generator
) -> Array:
    exposure_ms = of.exposure_ns / 1e6
    turn = 2 * np.pi * MAINS_HZ / 1e3
    mains = 1 + of.flicker * (np.sin(turn * (rows_ms + exposure_ms)) - np.sin(turn * rows_ms)) / (
        turn * exposure_ms
    )
    lit = lamp.strength * lamp.lit(rows_ms, exposure_ms)
    light = 0.35 * base * (mains[:, None] + falloff * lit[:, None])
    electrons = light * FULL_WELL
    electrons = electrons + rng.normal(0, 1, light.shape) * np.sqrt(np.maximum(electrons, 0) + 25)
    level = np.clip(electrons / FULL_WELL, 0, 1) ** of.gamma
    level = level - of.s_curve * np.sin(2 * np.pi * level) / (2 * np.pi)
    return np.clip(np.rint(255 * level), 0, 255).astype(np.uint8)


def _falloff(rng: np.random.Generator, height: int, width: int) -> Array:
    y, x = np.mgrid[0 : 1 : height * 1j, 0 : 1 : width * 1j]
    across, down = rng.uniform(0.2, 0.8, 2)
    return np.asarray(np.exp(-((x - across) ** 2 + (y - down) ** 2) / 0.5))
