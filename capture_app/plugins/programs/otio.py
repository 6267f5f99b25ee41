"""OpenTimelineIO: a take as a timeline for editors, a track of each camera, in step to a part of a frame."""

from datetime import datetime
from pathlib import Path

from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import VIDEOS, Exporter
from capture_app.session.exporting.videos import at_own_times, write_camera

TIMELINE = "timeline.otio"
SAME_RATE = 5e-4
"""Relative difference within which a rate is called the whole one; half of the difference of 29.97 and 30."""

DAY_S = 86_400


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write <camera>.mp4, each from its own first frame, and timeline.otio, in which a gap delays each.

    Gaps count from the burst's earliest image. Times in the timeline are in frames at the rig's rate. The
    start timecode of a video is its first frame's, to the nearest frame; the gaps have the rest.
    """
    import opentimelineio as otio

    rate = 1e9 / burst.period_ns
    if abs(rate - round(rate)) < SAME_RATE * rate:
        rate = float(round(rate))

    def frames(duration_ns: int) -> otio.opentime.RationalTime:
        return otio.opentime.RationalTime(duration_ns * rate / 1e9, rate)

    def of_day(frame: int) -> otio.opentime.RationalTime:
        return otio.opentime.RationalTime(frame, rate)

    timeline = otio.schema.Timeline(burst.name, global_start_time=of_day(first_frame(burst)))
    for camera in burst.cameras:
        first = burst.images_of(camera)[0]
        shown = at_own_times(burst, camera)
        first_ns, last_ns = shown[0][1], shown[-1][1]
        own = [(instant, since_ns - first_ns, image) for instant, since_ns, image in shown]
        start = first_frame(burst, first_ns)
        code = timecode_text(burst, start)
        write_camera(burst, folder / f"{camera}.mp4", own, camera, timecode=code)
        track = otio.schema.Track(camera, kind=otio.schema.TrackKind.Video)
        if first_ns:
            track.append(otio.schema.Gap(duration=frames(first_ns)))
        length = otio.opentime.TimeRange(of_day(start), frames(last_ns - first_ns + burst.period_ns))
        media = otio.schema.ExternalReference(f"{camera}.mp4", available_range=length)
        facts = {"leader_ns": first.leader_ns, "uncertainty_ns": first.uncertainty_ns}
        clip = otio.schema.Clip(camera, media, source_range=length, metadata={"simulshot": facts})
        track.append(clip)
        timeline.tracks.append(track)
    (folder / TIMELINE).write_text(otio.adapters.write_to_string(timeline, "otio_json"), encoding="utf-8")


def first_frame(burst: ExportedBurst, since_ns: int = 0) -> int:
    """Return the number of the frame that is `since_ns` after the burst's first image, since midnight UTC.

    The burst's first image has the time of day at which the session was written, in whole seconds.
    """
    created = datetime.fromisoformat(burst.session.manifest.created)
    of_day_s = created.hour * 3600 + created.minute * 60 + created.second
    return of_day_s * frames_per_second(burst) + round(since_ns / burst.period_ns)


def frames_per_second(burst: ExportedBurst) -> int:
    """Return the number of frames in a second of timecode; 0 for a rate that has no timecode."""
    return round(1e9 / burst.period_ns)


def timecode_text(burst: ExportedBurst, frame: int) -> str:
    """Return a frame's timecode as HH:MM:SS:FF, without dropped numbers; empty if the rate has none."""
    if not (rate := frames_per_second(burst)):
        return ""
    seconds, rest = divmod(frame, rate)
    minutes, second = divmod(seconds % DAY_S, 60)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}:{rest:02d}"


EXPORTER = Exporter(
    write=write,
    help="a timeline for video editors, with videos",
    program="OpenTimelineIO",
    packages={**VIDEOS, "opentimelineio": "otio"},
)
