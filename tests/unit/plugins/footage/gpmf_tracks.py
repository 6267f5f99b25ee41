"""GoPro metadata as its documentation says: what a camera with a GPS receiver writes every second."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from tests.unit.plugins.footage.cut_apart import Phone

BEGAN = datetime(2026, 6, 1, 10, 0, tzinfo=UTC)
"""True time 0."""
DAYS_EPOCH = datetime(2000, 1, 1, tzinfo=UTC)
GPS9_TYPE = b"lllllllSS"
GPS9_SCALE = (10_000_000, 10_000_000, 1000, 1000, 100, 1, 1000, 100, 1)


def item(key: bytes, kind: str, size: int, repeat: int, data: bytes) -> bytes:
    """One item: key, type, size of a sample, how many, and the bytes padded to 32 bits."""
    return key + bytes([ord(kind), size]) + struct.pack(">H", repeat) + data + bytes(-len(data) % 4)


def nest(key: bytes, *items: bytes) -> bytes:
    """Items within an item, which has type 0."""
    inside = b"".join(items)
    return item(key, "\0", 4, len(inside) // 4, inside)


def number(key: bytes, kind: str, value: int) -> bytes:
    layout = {"L": ">L", "S": ">H", "J": ">Q"}[kind]
    return item(key, kind, struct.calcsize(layout), 1, struct.pack(layout, value))


def scale(values: Sequence[int]) -> bytes:
    return item(b"SCAL", "l", 4, len(values), struct.pack(f">{len(values)}l", *values))


def device(*streams: bytes) -> bytes:
    """A payload: a device's number, its name and its streams."""
    return nest(b"DEVC", number(b"DVID", "L", 1), item(b"DVNM", "c", 1, 6, b"Camera"), *streams)


def shutter(stamp_us: int, frames: int = 30) -> bytes:
    times = struct.pack(f">{frames}f", *[0.004] * frames)
    return nest(b"STRM", number(b"STMP", "J", stamp_us), item(b"SHUT", "f", 4, frames, times))


def gps9(stamp_us: int, utcs: Sequence[datetime], *, fix: int = 3, dilution: float = 1.8) -> bytes:
    rows = []
    for utc in utcs:
        since = utc - DAYS_EPOCH
        of_day_ms = round((since - timedelta(days=since.days)) / timedelta(milliseconds=1))
        place = (525_000_000, 134_000_000, 40_000, 0, 0)
        rows.append(struct.pack(">7l2H", *place, since.days, of_day_ms, round(dilution * 100), fix))
    return nest(
        b"STRM",
        number(b"TSMP", "L", len(rows)),
        number(b"STMP", "J", stamp_us),
        item(b"TYPE", "c", 1, len(GPS9_TYPE), GPS9_TYPE),
        scale(GPS9_SCALE),
        item(b"GPS9", "?", 32, len(rows), b"".join(rows)),
    )


def gps5(text: bytes, *, fixes: int = 18, fix: int = 3, dilution: int = 180) -> bytes:
    rows = struct.pack(">5l", 525_000_000, 134_000_000, 40_000, 0, 0) * fixes
    return nest(
        b"STRM",
        number(b"GPSF", "L", fix),
        item(b"GPSU", "U", 16, 1, text),
        number(b"GPSP", "S", dilution),
        scale(GPS9_SCALE[:5]),
        item(b"GPS5", "l", 20, fixes, rows),
    )


@dataclass(frozen=True)
class Receiver:
    """A receiver whose fixes, ten a second, arrive late; `lock_s`: since when (true time) it has a 3D fix."""

    late_s: float
    jitter_s: float = 0.004
    lock_s: float = -1e9
    ahead_s: float = 0.0
    """How wrong its date is."""
    seed: int = 0

    def gps9_track(self, phone: Phone, seconds: int) -> list[bytes]:
        """A payload for each second of the camera's own time, with the fixes that arrived in it."""
        rng = np.random.default_rng(self.seed)
        count = 10 * (seconds + 2)
        fixes_s = np.ceil(phone.start_s * 10) / 10 - 0.5 + np.arange(count) / 10
        own_s = np.asarray(phone.own_s(fixes_s + self.late_s + rng.uniform(0, self.jitter_s, count)))
        track = []
        for second in range(seconds):
            inside = (own_s >= second) & (own_s < second + 1)
            first_s, lock = float(own_s[inside][0]), fixes_s[inside][0] >= self.lock_s
            utcs = [self._utc(at_s) for at_s in fixes_s[inside]]
            # The stamps' clock does not begin with the video.
            stamp_us = round(first_s * 1e6) + 70_000
            stream = gps9(stamp_us, utcs, fix=3 if lock else 0, dilution=1.8 if lock else 99.9)
            track.append(device(shutter(second * 1_000_000 + 70_000), stream))
        return track

    def gps5_track(self, phone: Phone, seconds: int) -> list[bytes]:
        """A payload for each second of the camera's own time, with the last whole fix's UTC."""
        track = []
        for second in range(seconds):
            at_s = np.floor((float(phone.true_s(second)) - self.late_s) * 18) / 18
            text = self._utc(at_s).strftime("%y%m%d%H%M%S.%f")[:16].encode()
            track.append(device(gps5(text)))
        return track

    def _utc(self, true_s: float) -> datetime:
        return BEGAN + timedelta(seconds=float(true_s) + self.ahead_s)
