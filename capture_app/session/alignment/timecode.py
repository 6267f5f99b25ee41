"""The timecode that a camera wrote into its video: which frame of the day is its first (SMPTE ST 12-1)."""

import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from capture_app.session.alignment.container import read_container

_TIMECODE = re.compile(r"(\d{2}):(\d{2}):(\d{2})([:;.])(\d{2,3})")
DAY_S = 86_400


@dataclass(frozen=True)
class Timecode:
    """When a video's first frame was taken by its timecode, s since midnight, and the time it is shown at, s.

    `wall_clock`: it keeps to the day; a timecode of a broken rate that drops no numbers runs slow.
    """

    day_s: float
    first_s: float
    period_s: float
    wall_clock: bool

    def offset_from(self, reference: "Timecode") -> float | None:
        """What makes the reference's times of this camera's, s; None where they count differently."""
        alike = abs(self.period_s - reference.period_s) < 1e-9
        if not (self.wall_clock and reference.wall_clock) and not (
            alike and self.wall_clock == reference.wall_clock
        ):
            return None
        apart = (self.day_s - reference.day_s + DAY_S / 2) % DAY_S - DAY_S / 2
        return apart + reference.first_s - self.first_s


def read_timecode(path: Path) -> Timecode | None:
    """The timecode of a video; None where it has none, or PyAV is not installed."""
    return read_container(path, _read)


def _read(_: Any, container: Any) -> Timecode | None:
    if not container.streams.video:
        return None
    video = container.streams.video[0]
    places = (*(stream.metadata for stream in container.streams), container.metadata)
    text = next((place["timecode"] for place in places if "timecode" in place), "")
    rate = video.guessed_rate or video.average_rate
    first = next((packet.pts for packet in container.demux(video) if packet.pts is not None), 0)
    first_s = float(first * video.time_base)
    return None if not rate else parse_timecode(text, Fraction(rate), first_s)


def parse_timecode(text: str, rate: Fraction, first_s: float = 0.0) -> Timecode | None:
    """A timecode at a frame rate; `;` or `.` before the frames drops numbers. None for anything else."""
    found = _TIMECODE.fullmatch(text.strip())
    if found is None:
        return None
    hours, minutes, seconds, frames = (int(found[k]) for k in (1, 2, 3, 5))
    nominal = round(rate)
    # Rates such as 29.97 are those of NTSC; a phone's average rate is only near one.
    exact = (
        Fraction(nominal * 1000, 1001) if abs(rate - Fraction(nominal * 1000, 1001)) < rate / 3000 else None
    )
    period = 1 / exact if exact is not None else Fraction(1, nominal)
    drops = found[4] in ";." and exact is not None and nominal % 30 == 0
    number = ((hours * 60 + minutes) * 60 + seconds) * nominal + frames
    if drops:
        whole = hours * 60 + minutes
        number -= nominal // 15 * (whole - whole // 10)
    return Timecode(float(number * period), first_s, float(period), exact is None or drops)
