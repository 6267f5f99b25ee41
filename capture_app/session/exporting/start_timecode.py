"""Timecode (SMPTE ST 12-1) of a take's videos, by which editors lay them side by side."""

from datetime import datetime

from capture_app.session.exporting.exported_burst import ExportedBurst

DAY_S = 86_400


def first_frame(burst: ExportedBurst, since_ns: int = 0) -> int:
    """Return the number of the frame that is `since_ns` after the burst's first image, since midnight UTC.

    The burst's first image has the time of day at which the session was written, in whole seconds.
    """
    created = datetime.fromisoformat(burst.session.manifest.created)
    of_day_s = created.hour * 3600 + created.minute * 60 + created.second
    return of_day_s * frames_per_second(burst) + round(since_ns / burst.period_ns)


def frames_per_second(burst: ExportedBurst) -> int:
    """Return how many frames a second of timecode has; 0 for a rate that has no timecode."""
    return round(1e9 / burst.period_ns)


def timecode_text(burst: ExportedBurst, frame: int) -> str:
    """Return a frame's timecode as HH:MM:SS:FF, without dropped numbers; empty if the rate has none."""
    if not (rate := frames_per_second(burst)):
        return ""
    seconds, rest = divmod(frame, rate)
    minutes, second = divmod(seconds % DAY_S, 60)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}:{rest:02d}"
