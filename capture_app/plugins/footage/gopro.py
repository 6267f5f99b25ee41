"""UTC from a GoPro's GPS receiver, read from the `gpmd` track (GPMF) of its videos.

A fix carries the satellites' time, but the camera records its arrival, and no published source states the
delay:

- GPS5 has one UTC a payload (about a second), without saying to which fix it belongs. Videos aligned by it
  were "always off by up to a second" (gpmf-parser issue 89); in issues 146 and 162 it jumps by 2.2 s between
  payloads, stands still, or is not a time at all.
- GPS9 (HERO11 on) has a UTC in ms for each fix, ten a second. GoPro says of clocks set by GPS that they are
  "typically within a frame or two", in limited testing (GoPro Labs, GPS time synchronization).
- STMP is the arrival time of a payload's first sample; for images, the start of the frame (issue 189).

GPMF, as the README of gpmf-parser describes it: nested items of key, type, size, repeat and data, big-endian,
padded to 32 bits; type 0 is a nest. Lengths in a file are checked against its size.
"""

import importlib
import math
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.alignment.alignment_method import AlignmentMethod
from capture_app.session.alignment.clock_line import compose, fit_clock_line
from capture_app.session.format.common_times import CameraTimes
from capture_app.session.format.lens import Array
from capture_app.session.importing.video_tracks import open_container

EPOCH = datetime(2000, 1, 1, tzinfo=UTC)
"""Epoch of GPS9's days, and of all UTC seconds in this module."""
DEPTH = 4
"""Maximum nesting depth that is read: DEVC contains STRM contains items."""
_HEADER = struct.Struct(">4sBBH")
_NUMBERS = {
    "b": "b", "B": "B", "s": "h", "S": "H", "l": "i", "L": "I", "j": "q", "J": "Q", "f": "f", "d": "d"
}  # fmt: skip
_LONGEST_TYPE = 64
GPS9_FIELDS = 9
"""Latitude, longitude, height, two speeds, days, seconds of the day, dilution of precision, fix."""
WORST_DILUTION = 5.0
"""Maximum dilution of precision; the format's README calls lower values good."""
MIN_FIXES = 3
"""Minimum number of fixes for an alignment."""
PAYLOAD_BYTES = 4_000_000
"""Maximum payload size that is read; a second of all GoPro sensors is some 100 kB."""
PAYLOADS = 100_000
JUMP_S = 0.5
"""Maximum scatter of the fixes' delays; above it the video is a time lapse, not in real time."""
MAX_STAMP_DELAY_S = 2.0
"""Maximum distance between a payload and the arrival of its first fix."""
LATE_S = {"GPS9": 0.2 / math.sqrt(2), "GPS5": 1.0 / math.sqrt(2)}
"""Delay of the recorded UTC after the fix, 95 %, by kind of stream, the better one first.

It is constant over a recording. It is derived from the published difference between two receivers: 1 s for
GPS5, two periods (0.2 s) for GPS9.
"""
WANDER_S = {"GPS9": 0.05, "GPS5": 0.25}
"""Change of that delay over a recording, s; standard deviation."""


GpsStream = tuple[str, float, list[tuple[float, float]]]
"""Kind of a payload's GPS stream, the delay of its first fix (s), and its good fixes.

The delay is from the exposure of the payload's first frame to the fix's arrival (STMP of both); 0 if the
camera does not record it. A fix has its place in the payload, from 0 to 1, and its UTC (s since 2000).
"""


@dataclass(frozen=True)
class _Item:
    key: str
    kind: str
    size: int
    data: bytes

    def numbers(self, kinds: str = "") -> list[tuple[float, ...]]:
        """Return each sample's numbers, of its own type or, if complex, of `kinds`; [] if not numeric."""
        if self.kind == "?":
            layout = ">" + "".join(_NUMBERS.get(kind, "?") for kind in kinds)
        else:
            number = _NUMBERS.get(self.kind, "")
            layout = f">{self.size // struct.calcsize(number)}{number}" if number else "?"
        if "?" in layout or self.size == 0 or struct.calcsize(layout) != self.size:
            return []
        return list(struct.iter_unpack(layout, self.data[: len(self.data) // self.size * self.size]))

    def first(self) -> float | None:
        """Return the first number of the first sample, or None."""
        numbers = self.numbers()
        return numbers[0][0] if numbers and numbers[0] and math.isfinite(numbers[0][0]) else None


def parse_payload(data: bytes) -> list[GpsStream]:
    """Return a payload's GPS streams with their good fixes: 3D, low dilution of precision. Never raises."""
    streams: list[tuple[str, float | None, list[tuple[float, float]]]] = []
    frame_stamp_us: float | None = None
    for items in _streams(data, DEPTH):
        named = {item.key: item for item in items}
        stamp_us = named["STMP"].first() if "STMP" in named else None
        if "GPS9" in named:
            streams.append(("GPS9", stamp_us, _gps9(named)))
        elif "GPS5" in named:
            streams.append(("GPS5", stamp_us, _gps5(named)))
        elif "SHUT" in named and frame_stamp_us is None:
            frame_stamp_us = stamp_us
    return [(key, _after_s(stamp_us, frame_stamp_us), fixes) for key, stamp_us, fixes in streams]


def _after_s(stamp_us: float | None, frame_stamp_us: float | None) -> float:
    after_s = 0.0 if stamp_us is None or frame_stamp_us is None else (stamp_us - frame_stamp_us) * 1e-6
    return after_s if abs(after_s) < MAX_STAMP_DELAY_S else 0.0


def _items(data: bytes) -> Iterator[_Item]:
    """Yield the items of a nest, up to the first with an impossible length."""
    at = 0
    while at + _HEADER.size <= len(data):
        key, kind, size, repeat = _HEADER.unpack_from(data, at)
        begin, length = at + _HEADER.size, size * repeat
        if begin + length > len(data) or key == bytes(4):
            return
        yield _Item(key.decode("latin-1"), chr(kind), size, data[begin : begin + length])
        at = begin + (length + 3) // 4 * 4


def _streams(data: bytes, depth: int) -> Iterator[list[_Item]]:
    """Yield the items of each STRM, at any nesting of its devices."""
    for item in _items(data) if depth else ():
        if item.kind == "\0" and item.key == "STRM":
            yield list(_items(item.data))
        elif item.kind == "\0":
            yield from _streams(item.data, depth - 1)


def _gps9(named: dict[str, _Item]) -> list[tuple[float, float]]:
    """Return the good fixes; each has its own UTC in ms and quality."""
    kinds = named["TYPE"].data.decode("latin-1").rstrip("\0") if "TYPE" in named else ""
    rows = named["GPS9"].numbers(kinds[:_LONGEST_TYPE])
    scale = [row[0] for row in named["SCAL"].numbers()] if "SCAL" in named else []
    good = []
    if len(scale) == GPS9_FIELDS and all(scale) and rows and len(rows[0]) == GPS9_FIELDS:
        for number, row in enumerate(rows):
            days, day_s, dilution, fix = (value / by for value, by in zip(row[5:], scale[5:], strict=True))
            utc_s = days * 86_400 + day_s
            is_time = days > 0 and 0 <= day_s < 86_401 and math.isfinite(utc_s)
            if is_time and fix == 3 and 0 < dilution < WORST_DILUTION:
                good.append((number / len(rows), utc_s))
    return good


def _gps5(named: dict[str, _Item]) -> list[tuple[float, float]]:
    """Return the first fix if it is good, with the one UTC of all fixes (GPSU), which is taken as its own."""
    fix, dilution = (named[key].first() if key in named else None for key in ("GPSF", "GPSP"))
    utc_s = parse_utc(named["GPSU"].data) if "GPSU" in named else None
    good = fix == 3 and dilution is not None and 0 < dilution / 100 < WORST_DILUTION
    return [(0.0, utc_s)] if good and utc_s is not None and named["GPS5"].numbers() else []


def parse_utc(text: bytes) -> float | None:
    """Parse `yymmddhhmmss.sss` to seconds since 2000; None for anything else, which some cameras write."""
    match = re.fullmatch(rb"(\d{12})\.(\d{3})", text[:16])
    with suppress(ValueError):
        if match is not None:
            at = datetime.strptime(f"20{match[1].decode()}", "%Y%m%d%H%M%S").replace(tzinfo=UTC)
            return (at - EPOCH) / timedelta(seconds=1) + int(match[2]) / 1000
    return None


@dataclass(frozen=True, eq=False)
class GpsClock:
    """Fixes (n,) of one recording from one kind of stream: video time and UTC (since 2000) of each, s.

    `end_s` is the end of the recording in video time; it starts at 0.
    """

    key: str
    video_s: Array
    utc_s: Array
    end_s: float

    @property
    def began_utc_s(self) -> float:
        """Return the UTC at the start of the recording, s, without correcting the delay."""
        return float(np.median(self.utc_s - self.video_s))


def read_gps_clock(path: Path) -> GpsClock:
    """Return a video's GPS clock. Raises BadInputError with a short reason if it has none."""
    with open_container(path) as (_, container):
        timed = list(islice(_payloads(container), PAYLOADS))
    why = ""
    for key in LATE_S:
        if isinstance(clock := _clock(key, timed), GpsClock):
            return clock
        why = why or clock
    raise BadInputError(why or "no GPS metadata of a GoPro")


def _payloads(container: Any) -> Iterator[tuple[float, float, list[GpsStream]]]:
    """Yield start and duration of each payload with a GPS stream, both s of the video, and its streams."""
    # Skip all other streams when reading from disk, if this PyAV can.
    skip: Any = getattr(importlib.import_module("av.stream"), "Discard", None)
    for stream in container.streams if skip is not None else ():
        stream.discard = skip.default if stream.type == "data" else skip.all
    tracks = container.streams.data
    for packet in container.demux(tracks) if tracks else ():
        is_timed = packet.pts is not None and 0 < packet.size <= PAYLOAD_BYTES
        if is_timed and (streams := parse_payload(bytes(packet))):
            begin_s, long_s = (float(n * packet.time_base) for n in (packet.pts, packet.duration or 0))
            yield begin_s, long_s, streams


def match_gps_clocks(reference: GpsClock, camera: GpsClock) -> CameraTimes:
    """Return the camera's times against the reference's, both via UTC; without an offset, the reason."""
    later_s = camera.began_utc_s - reference.began_utc_s
    apart_s = max(later_s - reference.end_s, -later_s - camera.end_s)
    if apart_s > LATE_S[reference.key] + LATE_S[camera.key]:
        return CameraTimes(reason=f"by their GPS, they are {apart_s:.1f} s apart")
    zero_s = math.floor(reference.utc_s[0])
    return compose(_line(reference, zero_s, of_utc=True), _line(camera, zero_s, of_utc=False))


def _line(clock: GpsClock, zero_s: float, *, of_utc: bool) -> CameraTimes:
    """Fit a camera's times (s) against UTC since `zero_s`; with `of_utc`, UTC against these times."""
    utc_s = clock.utc_s - zero_s
    # A slow drift does not average out: scaled like this, evenly spaced fixes improve neither offset nor
    # rate.
    sd_s = np.full(len(utc_s), WANDER_S[clock.key] * math.sqrt(len(utc_s) / 12))
    pair = (utc_s, clock.video_s) if of_utc else (clock.video_s, utc_s)
    return fit_clock_line(*pair, sd_s, "gopro", systematic_s=LATE_S[clock.key])


def _clock(key: str, timed: list[tuple[float, float, list[GpsStream]]]) -> GpsClock | str:
    """Return the good fixes of one kind, without outliers; otherwise the reason why there are too few."""
    own = [
        (begin_s, long_s, stream)
        for begin_s, long_s, streams in timed
        for stream in streams
        if stream[0] == key
    ]
    fixes: list[tuple[float, float]] = []
    before_s = -math.inf
    for begin_s, long_s, (_, after_s, stream) in own:
        for place, utc_s in stream:
            # A receiver without a new fix repeats the last time.
            if utc_s != before_s:
                fixes.append((begin_s + after_s + long_s * place, utc_s))
            before_s = utc_s
    if len(fixes) < MIN_FIXES:
        return f"its GPS has {len(fixes)} good 3D fixes" if own else ""
    video_s, utc_s = np.array(sorted(fixes)).T
    late_s = utc_s - video_s
    off_s = np.abs(late_s - np.median(late_s))
    scatter_s = 1.4826 * float(np.median(off_s))
    near = off_s <= max(5 * scatter_s, 0.02)
    if scatter_s > JUMP_S or near.sum() < MIN_FIXES:
        return "its GPS time does not go with the video's (a time lapse?)"
    return GpsClock(key, video_s[near], utc_s[near], max(begin_s + long_s for begin_s, long_s, _ in timed))


METHOD: AlignmentMethod[GpsClock] = AlignmentMethod(
    priority=2,
    of_video_times=True,
    read=lambda path, first_s: read_gps_clock(path),
    match=lambda reference, camera, error_s: match_gps_clocks(reference, camera),
)
