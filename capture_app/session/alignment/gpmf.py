"""GoPro's metadata format (GPMF): key, type, size, repeat, and as many bytes, nested in each other.

As the README of gpmf-parser describes it: all numbers are big-endian, every item is padded to 32 bits, and
type 0 is a nest. What a stranger's file says of its own lengths is not believed.
"""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

EPOCH = datetime(2000, 1, 1, tzinfo=UTC)
"""Of GPS9's days, and of all UTC seconds here."""
DEPTH = 4
"""DEVC holds STRM holds items; whatever is nested deeper than this is not looked at."""
_HEADER = struct.Struct(">4sBBH")
_NUMBERS = {
    "b": "b", "B": "B", "s": "h", "S": "H", "l": "i", "L": "I", "j": "q", "J": "Q", "f": "f", "d": "d"
}  # fmt: skip
_LONGEST_TYPE = 64
GPS9_FIELDS = 9
"""Latitude, longitude, height, two speeds, days, seconds of the day, dilution of precision, fix."""


@dataclass(frozen=True)
class GpsStream:
    """The fixes of one payload's GPS stream.

    `utc_s` (since 2000) of each that is good: by its number in the payload. `count`: how many there are, good
    or not. `stamp_us`: when the first arrived (STMP).
    """

    key: str
    count: int
    utc_s: dict[int, float]
    stamp_us: int | None


@dataclass(frozen=True)
class Payload:
    """What one payload tells of time; `frame_stamp_us`: when its first frame was exposed (STMP)."""

    streams: tuple[GpsStream, ...]
    frame_stamp_us: int | None


@dataclass(frozen=True)
class _Item:
    key: str
    kind: str
    size: int
    data: bytes

    def numbers(self, kinds: str = "") -> list[tuple[float, ...]]:
        """Each sample's numbers, of its own kind, or of `kinds` where it is complex; [] if they are none."""
        if self.kind == "?":
            layout = ">" + "".join(_NUMBERS.get(kind, "?") for kind in kinds)
        else:
            number = _NUMBERS.get(self.kind, "")
            layout = f">{self.size // struct.calcsize(number)}{number}" if number else "?"
        if "?" in layout or self.size == 0 or struct.calcsize(layout) != self.size:
            return []
        whole = len(self.data) // self.size * self.size
        return list(struct.iter_unpack(layout, self.data[:whole]))

    def first(self) -> float | None:
        """Its first number."""
        found = self.numbers()
        return found[0][0] if found and found[0] and math.isfinite(found[0][0]) else None


def parse_payload(data: bytes, *, worst_dilution: float) -> Payload:
    """The GPS streams of a payload with their 3D fixes below a dilution of precision; never raises."""
    streams: list[GpsStream] = []
    frame_stamps: list[int] = []
    for items in _streams(data, DEPTH):
        named = {item.key: item for item in items}
        stamp = named["STMP"].first() if "STMP" in named else None
        stamp_us = None if stamp is None else round(stamp)
        if "GPS9" in named:
            streams.append(_gps9(named, stamp_us, worst_dilution))
        elif "GPS5" in named:
            streams.append(_gps5(named, stamp_us, worst_dilution))
        elif "SHUT" in named and stamp_us is not None:
            frame_stamps.append(stamp_us)
    return Payload(tuple(streams), frame_stamps[0] if frame_stamps else None)


def _items(data: bytes) -> Iterator[_Item]:
    """The items of a nest, up to the first whose length cannot be."""
    at = 0
    while at + _HEADER.size <= len(data):
        key, kind, size, repeat = _HEADER.unpack_from(data, at)
        begin, length = at + _HEADER.size, size * repeat
        if begin + length > len(data) or key == bytes(4):
            return
        yield _Item(key.decode("latin-1"), chr(kind), size, data[begin : begin + length])
        at = begin + (length + 3) // 4 * 4


def _streams(data: bytes, depth: int) -> Iterator[list[_Item]]:
    """The items of each STRM, however its devices are nested."""
    for item in _items(data):
        if item.kind != "\0" or depth == 0:
            continue
        if item.key == "STRM":
            yield list(_items(item.data))
        else:
            yield from _streams(item.data, depth - 1)


def _gps9(named: dict[str, _Item], stamp_us: int | None, worst: float) -> GpsStream:
    """Every fix has a UTC of its own, in ms, and says how good it is."""
    kinds = named["TYPE"].data.decode("latin-1").rstrip("\0") if "TYPE" in named else ""
    rows = named["GPS9"].numbers(kinds[:_LONGEST_TYPE])
    scale = [row[0] for row in named["SCAL"].numbers()] if "SCAL" in named else []
    good = {}
    if len(scale) == GPS9_FIELDS and all(scale) and rows and len(rows[0]) == GPS9_FIELDS:
        for number, row in enumerate(rows):
            days, day_s, dilution, fix = (value / by for value, by in zip(row[5:], scale[5:], strict=True))
            utc_s = days * 86_400 + day_s
            if (
                fix == 3
                and 0 < dilution < worst
                and days > 0
                and 0 <= day_s < 86_401
                and math.isfinite(utc_s)
            ):
                good[number] = utc_s
    return GpsStream("GPS9", len(rows), good, stamp_us)


def _gps5(named: dict[str, _Item], stamp_us: int | None, worst: float) -> GpsStream:
    """One UTC for all fixes of a payload (GPSU): that of the first, as far as anything says."""
    count = len(named["GPS5"].numbers())
    fix, dilution = (named[key].first() if key in named else None for key in ("GPSF", "GPSP"))
    utc_s = parse_utc(named["GPSU"].data) if "GPSU" in named else None
    good = count and fix == 3 and dilution is not None and 0 < dilution / 100 < worst and utc_s is not None
    return GpsStream("GPS5", count, {0: utc_s} if good and utc_s is not None else {}, stamp_us)


def parse_utc(text: bytes) -> float | None:
    """Seconds since 2000 of `yymmddhhmmss.sss`; None of anything else, which cameras do write."""
    word = text[:16].decode("latin-1")
    digits = word[:12] + word[13:]
    if len(word) != 16 or word[12] != "." or not (digits.isascii() and digits.isdigit()):
        return None
    year, month, day, hour, minute, second = (int(word[at : at + 2]) for at in range(0, 12, 2))
    try:
        at = datetime(2000 + year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return (at - EPOCH) / timedelta(seconds=1) + int(word[13:]) / 1000
