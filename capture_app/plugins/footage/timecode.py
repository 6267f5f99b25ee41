"""Alignment by the timecode (SMPTE ST 12-1) of each video's first frame."""

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.session.alignment.alignment_method import AlignmentMethod
from capture_app.session.alignment.clock_line import CRYSTAL_PPM, SIGMAS
from capture_app.session.format.common_times import CameraTimes
from capture_app.session.importing.video_tracks import open_container

_TIMECODE = re.compile(r"(\d{2}):(\d{2}):(\d{2})([:;.])(\d{2,3})")
_GOPRO_FILE = re.compile(r"(G[HXLS]|GP)\d{6}|GOPR\d{4}")
DAY_S = 86_400
GOPRO_S = 2.0
"""Error of the clock of a GoPro that was set, 95 %, s: by QR code it is one to two seconds off."""


@dataclass(frozen=True)
class Timecode:
    """Timecode of a video's first frame, s since midnight, and its presentation time, s.

    `wall_clock`: it follows the time of day. At a fractional frame rate without drop-frame counting it runs
    slow.
    """

    day_s: float
    first_s: float
    period_s: float
    wall_clock: bool
    clock_error_s: float = 0.0
    """Error of the clock that it follows (95 %), beside its frame."""
    text: str = ""


def match_timecodes(reference: Timecode, camera: Timecode) -> CameraTimes:
    """Return the camera's times against the reference's; without an offset, the reason."""
    if reference.text == camera.text:
        return CameraTimes(
            reason=f"both timecodes begin at {camera.text}, as counters do that start with each clip"
        )
    same_rate = abs(camera.period_s - reference.period_s) < 1e-9 and camera.wall_clock == reference.wall_clock
    if not same_rate and not (camera.wall_clock and reference.wall_clock):
        return CameraTimes(reason="their timecodes count at different rates")
    apart_s = (camera.day_s - reference.day_s + DAY_S / 2) % DAY_S - DAY_S / 2
    # A timecode identifies a frame; the exposures of two cameras are anywhere within it.
    return CameraTimes(
        offset_ns=round((apart_s + reference.first_s - camera.first_s) * 1e9),
        uncertainty_ns=round(
            (
                max(reference.period_s, camera.period_s)
                + math.hypot(reference.clock_error_s, camera.clock_error_s)
            )
            * 1e9
        ),
        rate_uncertainty_ppm=SIGMAS * CRYSTAL_PPM,
        epoch_local_ns=round(camera.first_s * 1e9),
        source="timecode",
    )


def read_timecode(path: Path, first_s: float) -> Timecode:
    """Return the timecode of a video with its first frame at `first_s`.

    `;` or `.` before its frames means drop-frame. Raises BadInputError with a short reason if there is none.
    """
    with open_container(path) as (_, container):
        streams = container.streams
        places = (*(stream.metadata for stream in streams), container.metadata)
        text = next((place["timecode"] for place in places if "timecode" in place), "")
        handlers = " ".join(place.get("handler_name", "") for place in places)
        rate = streams.video and (streams.video[0].guessed_rate or streams.video[0].average_rate)
    nominal = round(rate or 0)
    if (match := _TIMECODE.fullmatch(text.strip())) is None or not nominal:
        raise BadInputError("it has no timecode")
    hours, minutes, seconds, frames = (int(match[k]) for k in (1, 2, 3, 5))
    # Rates such as 29.97 are NTSC's; a phone's average rate is only close to one.
    ntsc = Fraction(nominal * 1000, 1001)
    fractional = abs(rate - ntsc) < rate / 3000
    period = 1 / ntsc if fractional else Fraction(1, nominal)
    drops = match[4] in ";." and fractional and nominal % 30 == 0
    whole = hours * 60 + minutes
    number = (whole * 60 + seconds) * nominal + frames
    if drops:
        number -= nominal // 15 * (whole - whole // 10)
    return Timecode(
        day_s=float(number * period),
        first_s=first_s,
        period_s=float(period),
        wall_clock=not fractional or drops,
        clock_error_s=GOPRO_S if "GoPro" in handlers or _GOPRO_FILE.fullmatch(path.stem) else 0.0,
        text=text.strip(),
    )


METHOD: AlignmentMethod[Timecode] = AlignmentMethod(
    priority=1,
    of_video_times=False,
    read=read_timecode,
    match=lambda reference, camera, error_s: match_timecodes(reference, camera),
    doubt=lambda times: "clocks that nobody set, and counters of recorded time, give such timecodes, too",
)
"""After GPS: a GoPro's timecode follows its own clock, which is rarely set to the second."""
