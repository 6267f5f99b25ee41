"""Time of day from a GoPro's GPS receiver, read from the `gpmd` track (GPMF) of its videos.

A fix has the satellites' time, but the camera notes its arrival, and nothing published says how late that
is:

- GPS5 has one UTC a payload (about a second), and nothing says which of its fixes is meant. Videos laid over
  each other by it were "always off by up to a second" (gpmf-parser issue 89); in issues 146 and 162 it jumps
  by 2.2 s between payloads, stands still, or is no time at all.
- GPS9 (HERO11 on) has a UTC in ms for each fix, ten a second. GoPro says of clocks set by GPS that they are
  "typically within a frame or two", in limited testing (GoPro Labs, GPS time synchronization).
- STMP is when the first sample of a payload arrived; of images, when the frame began (issue 189).

GPMF, as the README of gpmf-parser describes it: nested items of key, type, size, repeat and data,
big-endian, padded to 32 bits; type 0 is a nest. The lengths that a file states are checked against its size.
"""

import importlib
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from capture_app.session.alignment.clock_line import compose, fit_clock_line
from capture_app.session.alignment.tracks import read_container
from capture_app.session.format.common_times import CameraTimes

EPOCH = datetime(2000, 1, 1, tzinfo=UTC)
"""The zero of GPS9's days, and of all UTC seconds here."""
DEPTH = 4
"""DEVC holds STRM holds items; whatever is nested deeper than this is not looked at."""
_HEADER = struct.Struct(">4sBBH")
_NUMBERS = {
    "b": "b", "B": "B", "s": "h", "S": "H", "l": "i", "L": "I", "j": "q", "J": "Q", "f": "f", "d": "d"
}  # fmt: skip
_LONGEST_TYPE = 64
GPS9_FIELDS = 9
"""Latitude, longitude, height, two speeds, days, seconds of the day, dilution of precision, fix."""
WORST_DILUTION = 5.0
"""Dilution of precision; better is good, says the format's README."""
FEWEST = 3
"""Fixes that a camera's time can rest on."""
PAYLOAD_BYTES = 4_000_000
"""The largest payload that is read; a second of all that a GoPro measures is some 100 kB."""
PAYLOADS = 100_000
JUMP_S = 0.5
"""Fixes whose lateness spreads wider than this were not recorded at the video's pace: a time lapse."""
STAMP_REACH_S = 2.0
"""How far from its payload the first fix of it may have arrived."""
LATE_S = {"GPS9": 0.2 / math.sqrt(2), "GPS5": 1.0 / math.sqrt(2)}
"""By kind of stream, the better first: how much later than the fix its UTC may have been noted (95 %).

The same for the whole recording: two receivers together are as far apart as was published of GPS5 (1 s), and
two periods of GPS9 (0.2 s).
"""
WANDER_S = {"GPS9": 0.05, "GPS5": 0.25}
"""How much that may change from the beginning of a recording to its end (sd)."""


class GpsStream(NamedTuple):
    """The fixes of one payload's GPS stream.

    `utc_s` (since 2000) of each that is good: by its number in the payload. `number`: how many there are,
    good or not. `after_s`: how long after the payload's first frame was exposed the first of them arrived
    (STMP of both); 0 where the camera does not say.
    """

    key: str
    number: int
    utc_s: dict[int, float]
    after_s: float = 0.0


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
        """The first number of the first sample; None where there is none."""
        found = self.numbers()
        return found[0][0] if found and found[0] and math.isfinite(found[0][0]) else None


def parse_payload(data: bytes) -> list[GpsStream]:
    """The GPS streams of a payload with their 3D fixes of a good dilution of precision; never raises."""
    found: list[tuple[GpsStream, float | None]] = []
    frame_stamp_us: float | None = None
    for items in _streams(data, DEPTH):
        named = {item.key: item for item in items}
        stamp_us = named["STMP"].first() if "STMP" in named else None
        if "GPS9" in named:
            found.append((GpsStream("GPS9", *_gps9(named)), stamp_us))
        elif "GPS5" in named:
            found.append((GpsStream("GPS5", *_gps5(named)), stamp_us))
        elif "SHUT" in named and frame_stamp_us is None:
            frame_stamp_us = stamp_us
    return [stream._replace(after_s=_after_s(stamp_us, frame_stamp_us)) for stream, stamp_us in found]


def _after_s(stamp_us: float | None, frame_stamp_us: float | None) -> float:
    if stamp_us is None or frame_stamp_us is None:
        return 0.0
    after_s = (stamp_us - frame_stamp_us) * 1e-6
    return after_s if abs(after_s) < STAMP_REACH_S else 0.0


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


def _gps9(named: dict[str, _Item]) -> tuple[int, dict[int, float]]:
    """How many fixes there are, and the UTC of the good ones: each has one in ms, and says how good it is."""
    kinds = named["TYPE"].data.decode("latin-1").rstrip("\0") if "TYPE" in named else ""
    rows = named["GPS9"].numbers(kinds[:_LONGEST_TYPE])
    scale = [row[0] for row in named["SCAL"].numbers()] if "SCAL" in named else []
    good = {}
    if len(scale) == GPS9_FIELDS and all(scale) and rows and len(rows[0]) == GPS9_FIELDS:
        for number, row in enumerate(rows):
            days, day_s, dilution, fix = (value / by for value, by in zip(row[5:], scale[5:], strict=True))
            utc_s = days * 86_400 + day_s
            is_time = days > 0 and 0 <= day_s < 86_401 and math.isfinite(utc_s)
            if is_time and fix == 3 and 0 < dilution < WORST_DILUTION:
                good[number] = utc_s
    return len(rows), good


def _gps5(named: dict[str, _Item]) -> tuple[int, dict[int, float]]:
    """As `_gps9`, where one UTC is for all fixes (GPSU): that of the first, as far as anything says."""
    count = len(named["GPS5"].numbers())
    fix, dilution = (named[key].first() if key in named else None for key in ("GPSF", "GPSP"))
    utc_s = parse_utc(named["GPSU"].data) if "GPSU" in named else None
    good = count and fix == 3 and dilution is not None and 0 < dilution / 100 < WORST_DILUTION
    return count, {0: utc_s} if good and utc_s is not None else {}


def parse_utc(text: bytes) -> float | None:
    """Seconds since 2000 of `yymmddhhmmss.sss`; None of anything else, which cameras do write."""
    word = text[:16].decode("latin-1")
    digits = word[:12] + word[13:]
    if len(word) != 16 or word[12] != "." or not (digits.isascii() and digits.isdigit()):
        return None
    try:
        at = datetime.strptime(f"20{word[:12]}", "%Y%m%d%H%M%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    return (at - EPOCH) / timedelta(seconds=1) + int(word[13:]) / 1000


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GpsClock:
    """Fixes (n,) of one recording: the video's time and UTC (since 2000) of each, s, by one kind of stream.

    `end_s`: when the recording ended, by the video's time; it began at 0.
    """

    key: str
    video_s: Array
    utc_s: Array
    end_s: float

    @property
    def began_utc_s(self) -> float:
        """When the recording began, to its error."""
        return float(np.median(self.utc_s - self.video_s))


def read_gps_clock(path: Path) -> GpsClock | str:
    """What a video's GPS says of UTC; else why it says nothing."""
    timed = read_container(path, lambda _, container: list(islice(_payloads(container), PAYLOADS)))
    if isinstance(timed, str):
        return timed
    clocks = [_clock(key, timed) for key in LATE_S]
    good = next((clock for clock in clocks if isinstance(clock, GpsClock)), None)
    return good or next((why for why in clocks if isinstance(why, str) and why), "no GPS metadata of a GoPro")


def _payloads(container: Any) -> Iterator[tuple[float, float, list[GpsStream]]]:
    """When each payload with a GPS stream begins, how long it is, both s of the video, and what it tells."""
    # Only what is data is read from the disk, where PyAV can.
    skip: Any = getattr(importlib.import_module("av.stream"), "Discard", None)
    for stream in container.streams if skip is not None else ():
        stream.discard = skip.default if stream.type == "data" else skip.all
    tracks = container.streams.data
    for packet in container.demux(tracks) if tracks else ():
        if packet.pts is None or not 0 < packet.size <= PAYLOAD_BYTES:
            continue
        streams = parse_payload(bytes(packet))
        if streams:
            begin_s, long_s = (float(n * packet.time_base) for n in (packet.pts, packet.duration or 0))
            yield begin_s, long_s, streams


def match_gps_clocks(reference: GpsClock, camera: GpsClock) -> CameraTimes:
    """The camera's times against the reference's, each by UTC; without an offset, why there is none."""
    later_s = camera.began_utc_s - reference.began_utc_s
    apart_s = max(later_s - reference.end_s, -later_s - camera.end_s)
    if apart_s > LATE_S[reference.key] + LATE_S[camera.key]:
        return CameraTimes(reason=f"by their GPS, {apart_s:.1f} s lie between them")
    zero_s = math.floor(reference.utc_s[0])
    back = _line(reference, zero_s, of_utc=True)
    return compose(back, _line(camera, zero_s, of_utc=False))


def _line(clock: GpsClock, zero_s: float, *, of_utc: bool) -> CameraTimes:
    """A camera's times against UTC since `zero_s`; or UTC's against the camera's."""
    utc_s = clock.utc_s - zero_s
    # What wanders slowly is no less for many fixes; so wide, evenly spread ones tell no better rate.
    sd_s = np.full(len(utc_s), WANDER_S[clock.key] * math.sqrt(len(utc_s) / 12))
    pair = (utc_s, clock.video_s) if of_utc else (clock.video_s, utc_s)
    return fit_clock_line(*pair, sd_s, "gopro", systematic_s=LATE_S[clock.key])


def _clock(key: str, timed: list[tuple[float, float, list[GpsStream]]]) -> GpsClock | str:
    """The good fixes of one kind, less those that others contradict; else why there are too few."""
    fixes: list[tuple[float, float]] = []
    seen, before_s = False, -math.inf
    for begin_s, long_s, streams in timed:
        for stream in streams:
            if stream.key != key:
                continue
            seen = True
            first_s = begin_s + stream.after_s
            for number, utc_s in stream.utc_s.items():
                # A receiver that has nothing new says the last time again.
                if utc_s != before_s:
                    fixes.append((first_s + long_s * number / stream.number, utc_s))
                before_s = utc_s
    if not seen:
        return ""
    if len(fixes) < FEWEST:
        return f"its GPS has {len(fixes)} good 3D fixes"
    video_s, utc_s = np.array(sorted(fixes)).T
    late_s = utc_s - video_s
    off_s = np.abs(late_s - np.median(late_s))
    spread_s = 1.4826 * float(np.median(off_s))
    near = off_s <= max(5 * spread_s, 0.02)
    if spread_s > JUMP_S or near.sum() < FEWEST:
        return "its GPS time does not go with the video's (a time lapse?)"
    return GpsClock(key, video_s[near], utc_s[near], max(begin_s + long_s for begin_s, long_s, _ in timed))
