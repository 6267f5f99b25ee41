"""Aligns the videos of a recording that have no common times, by what all of them hold."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum

from capture_app.errors import BadInputError
from capture_app.session.alignment.clock_line import CRYSTAL_PPM, SIGMAS, chain_cameras, fit_clock_line
from capture_app.session.alignment.flashes import Lights, match_flashes, read_lights
from capture_app.session.alignment.gopro import GpsClock, match_gps_clocks, read_gps_clock
from capture_app.session.alignment.tracks import Sound, Timecode, match_sounds, read_sound, read_timecode
from capture_app.session.format.common_times import CameraTimes, CommonTimes, TimesState
from capture_app.session.importers.frame_matching import TimedFrame, Timeline, timeline_by_times
from capture_app.session.importers.sources import Source, Video

Against = Callable[[str, str], CameraTimes]
"""The times of the second camera against the first's; without an offset, why there is none."""


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
    starts_s = _starts_s(timeline)
    makers: dict[AlignBy, Callable[[], Against]] = {
        AlignBy.SOUND: lambda: _by_sound(videos, sound_error_s),
        AlignBy.FLASH: lambda: _by_flash(videos),
        # A GoPro's timecode is its own clock's, which is hardly ever set to the second.
        AlignBy.GOPRO: lambda: _by_gopro(videos),
        AlignBy.TIMECODE: lambda: _by_timecode(videos, starts_s),
    }
    reasons: list[str] = []
    for method, make in makers.items():
        if by not in (AlignBy.AUTO, method) or (method in _OF_VIDEO_TIMES and rate_given):
            continue
        cameras = chain_cameras(names, make())
        lacking = {name: of.reason for name, of in cameras.items() if of.offset_ns is None}
        if not lacking:
            return CommonTimes(
                state=TimesState.ALIGNED, reason=f"by {method}", reference=names[0], cameras=cameras
            )
        reasons.append(f"by {method}: " + "; ".join(f"{name}: {why}" for name, why in lacking.items()))
    return CommonTimes(state=unknown.state, reason=", not aligned ".join([unknown.reason, *reasons]))


def with_common_times(timeline: Timeline, common: CommonTimes) -> Timeline:
    """The same frames at the recording's times, matched anew."""
    cameras: dict[str, list[TimedFrame]] = {}
    for instant in timeline.instants:
        for name, frame in instant.frames.items():
            own_ns = frame.leader_ns if frame.local_ns is None else frame.local_ns
            times = common.cameras[name]
            moved = replace(
                frame,
                leader_ns=times.leader_from_local(own_ns),
                local_ns=own_ns,
                further={**frame.further, "uncertainty_ns": times.uncertainty_at_ns(own_ns)},
            )
            cameras.setdefault(name, []).append(moved)
    return timeline_by_times("the recording", cameras)


def _starts_s(timeline: Timeline) -> Mapping[str, float]:
    """When each camera's first frame was taken, by its own times."""
    starts: dict[str, float] = {}
    for instant in timeline.instants:
        for name, frame in instant.frames.items():
            starts[name] = min(starts.get(name, frame.leader_ns / 1e9), frame.leader_ns / 1e9)
    return starts


def _by_sound(videos: Sequence[Video], error_s: float) -> Against:
    sounds: dict[str, Sound | None] = {video.name: read_sound(video.path) for video in videos}

    def against(first: str, second: str) -> CameraTimes:
        reference, camera = sounds[first], sounds[second]
        if reference is None or camera is None:
            return CameraTimes(reason=f"{first if reference is None else second} has no sound")
        moments = match_sounds(reference, camera)
        if isinstance(moments, str):
            return CameraTimes(reason=moments)
        return fit_clock_line(moments, AlignBy.SOUND, systematic_s=error_s)

    return against


def _by_flash(videos: Sequence[Video]) -> Against:
    lights: dict[str, Lights | None] = {video.name: read_lights(video.path) for video in videos}

    def against(first: str, second: str) -> CameraTimes:
        reference, camera = lights[first], lights[second]
        if reference is None or camera is None:
            return CameraTimes(reason=f"{first if reference is None else second} cannot be decoded")
        return match_flashes(reference, camera, AlignBy.FLASH)

    return against


def _by_gopro(videos: Sequence[Video]) -> Against:
    clocks: dict[str, GpsClock | str] = {video.name: read_gps_clock(video.path) for video in videos}

    def against(first: str, second: str) -> CameraTimes:
        reference, camera = clocks[first], clocks[second]
        if isinstance(reference, str):
            return CameraTimes(reason=f"{first} tells no UTC: {reference}")
        if isinstance(camera, str):
            return CameraTimes(reason=camera)
        return match_gps_clocks(reference, camera, AlignBy.GOPRO)

    return against


def _by_timecode(videos: Sequence[Video], starts_s: Mapping[str, float]) -> Against:
    codes: dict[str, Timecode | None] = {}
    for video in videos:
        code = read_timecode(video.path)
        codes[video.name] = None if code is None else replace(code, first_s=starts_s[video.name])

    def against(first: str, second: str) -> CameraTimes:
        reference, camera = codes[first], codes[second]
        if reference is None or camera is None:
            return CameraTimes(reason=f"{first if reference is None else second} has no timecode")
        offset_s = camera.offset_from(reference)
        if offset_s is None:
            return CameraTimes(reason="their timecodes count at different rates")
        # A timecode names a frame: within it, the exposures of two cameras lie anywhere.
        return CameraTimes(
            offset_ns=round(offset_s * 1e9),
            uncertainty_ns=round(max(reference.period_s, camera.period_s) * 1e9),
            rate_uncertainty_ppm=SIGMAS * CRYSTAL_PPM,
            epoch_local_ns=round(camera.first_s * 1e9),
            source=AlignBy.TIMECODE,
        )

    return against
