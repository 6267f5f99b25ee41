"""Aligns the videos of a recording that have no common times, by what all of them hold."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import partial
from typing import Any

from capture_app.errors import BadInputError
from capture_app.session.alignment.clock_line import chain_cameras
from capture_app.session.alignment.flashes import match_flashes, read_lights
from capture_app.session.alignment.gopro import match_gps_clocks, read_gps_clock
from capture_app.session.alignment.tracks import match_sounds, match_timecodes, read_sound, read_timecode
from capture_app.session.format.common_times import CameraTimes, CommonTimes, TimesState
from capture_app.session.importers.frame_matching import TimedFrame, Timeline, timeline_by_times
from capture_app.session.importers.sources import Source, Video


class AlignBy(StrEnum):
    """What a recording without common times is aligned by."""

    AUTO = "auto"
    """Each of the others in turn, the most trustworthy first, until one tells all cameras' offsets."""
    NONE = "none"
    FLASH = "flash"
    GOPRO = "gopro"
    SOUND = "sound"
    TIMECODE = "timecode"


_OF_VIDEO_TIMES = (AlignBy.SOUND, AlignBy.FLASH, AlignBy.GOPRO)


def align_recording(
    sources: Sequence[Source],
    timeline: Timeline,
    unknown: CommonTimes,
    by: AlignBy,
    *,
    sound_error_s: float,
    rate_given: bool = False,
) -> CommonTimes:
    """The state of the times after alignment, each camera's with it; `unknown` where nothing tells.

    `sound_error_s` (95 %): what the sounds of two cameras' pictures may be apart though they were one.
    `rate_given`: frames are timed by a rate, not by their videos, so that sound has other times. Raises
    BadInputError where a method was asked for that these sources cannot have.
    """
    videos = [source for source in sources if isinstance(source, Video)]
    if by is AlignBy.NONE or len(videos) < len(sources):
        if by not in (AlignBy.AUTO, AlignBy.NONE):
            raise BadInputError(f"--align {by} is for videos", hint="these are images: leave it out")
        return unknown
    if by in _OF_VIDEO_TIMES and rate_given:
        raise BadInputError(
            f"--align {by} takes the videos' own times", hint="--times video instead of --fps"
        )
    names = [source.name for source in videos]
    starts_s = {name: min(frame.leader_ns for frame in of) / 1e9 for name, of in timeline.cameras().items()}
    methods: dict[AlignBy, tuple[Callable[[Video], Any], Callable[[Any, Any], CameraTimes]]] = {
        AlignBy.SOUND: (lambda of: read_sound(of.path), partial(match_sounds, error_s=sound_error_s)),
        AlignBy.FLASH: (lambda of: read_lights(of.path), match_flashes),
        # A GoPro's timecode is its own clock's, which is hardly ever set to the second.
        AlignBy.GOPRO: (lambda of: read_gps_clock(of.path), match_gps_clocks),
        AlignBy.TIMECODE: (lambda of: read_timecode(of.path, starts_s[of.name]), match_timecodes),
    }
    reasons: list[str] = []
    for method, (read, match) in methods.items():
        if by not in (AlignBy.AUTO, method) or (method in _OF_VIDEO_TIMES and rate_given):
            continue
        cameras = chain_cameras(names, partial(_against, match, {one.name: read(one) for one in videos}))
        lacking = {name: of.reason for name, of in cameras.items() if of.offset_ns is None}
        if not lacking:
            return CommonTimes(
                state=TimesState.ALIGNED, reason=f"by {method}", reference=names[0], cameras=cameras
            )
        reasons.append(f"by {method}: " + "; ".join(f"{name}: {why}" for name, why in lacking.items()))
    return CommonTimes(state=unknown.state, reason=", not aligned ".join([unknown.reason, *reasons]))


def with_common_times(timeline: Timeline, common: CommonTimes) -> Timeline:
    """The frames at the recording's times, matched anew."""
    cameras = {
        name: [_at_common_time(frame, common.cameras[name]) for frame in frames]
        for name, frames in timeline.cameras().items()
    }
    return timeline_by_times("the recording", cameras)


def _at_common_time(frame: TimedFrame, times: CameraTimes) -> TimedFrame:
    own_ns = frame.leader_ns if frame.local_ns is None else frame.local_ns
    further = {**frame.further, "uncertainty_ns": times.uncertainty_at_ns(own_ns)}
    return replace(frame, leader_ns=times.leader_from_local(own_ns), local_ns=own_ns, further=further)


def _against(
    match: Callable[[Any, Any], CameraTimes], read: Mapping[str, Any], first: str, second: str
) -> CameraTimes:
    """The second camera's times against the first's, by what was read of both; else why there are none."""
    if isinstance(read[first], str):
        return CameraTimes(reason=f"{first}: {read[first]}")
    if isinstance(read[second], str):
        return CameraTimes(reason=read[second])
    return match(read[first], read[second])
