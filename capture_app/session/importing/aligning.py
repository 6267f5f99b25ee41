"""Alignment of videos without common times, by methods that are plugins: sound, flashes, timecode, GPS."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.common.text import Talk
from capture_app.session.alignment.alignment_method import AlignmentMethod, alignment_methods
from capture_app.session.alignment.clock_line import Against, chain_cameras, measure_pairs
from capture_app.session.format.common_times import REFERENCE, CameraTimes, CommonTimes
from capture_app.session.importing.frame_matching import TimedFrame, Timeline, timeline_by_times, trim
from capture_app.session.importing.recording_sources import Source, Video
from capture_app.session.importing.times.rules import Times

MOTION = "motion"
"""Alignment by what moves, which is the reconstruction's, on the session as it is written."""
SOUND_M_PER_S = 343.0
SOUND_DISTANCE_M = 1.0
SOUND_DELAY_MS = 20.0
"""Assumed: there is no measurement of the cameras' sound delay."""


@dataclass(frozen=True, kw_only=True)
class AlignmentOptions:
    """How cameras without common times are aligned."""

    align: str = "auto"
    """Method that aligns a recording without common times: see `align_recording`."""
    sound_distance_m: float = SOUND_DISTANCE_M
    """Maximum difference between the cameras' distances to a sound, m."""
    sound_delay_ms: float = SOUND_DELAY_MS
    """Maximum difference between two cameras' delays from image to sound, ms (95 %)."""

    @property
    def sound_error_s(self) -> float:
        """Possible offset between two cameras' sounds while their images are simultaneous, s (95 %)."""
        return self.sound_distance_m / SOUND_M_PER_S + self.sound_delay_ms / 1000


@dataclass(frozen=True, slots=True)
class Aligned:
    """The cameras that have common times, if any have; the timeline by these, and what is known of it."""

    sources: Sequence[Source]
    timeline: Timeline
    common: CommonTimes | None

    @property
    def own_times(self) -> bool:
        """Whether the frames' times are each camera's own."""
        return self.common is not None and self.common.unknown


def align_times(sources: Sequence[Source], times: Times, options: AlignmentOptions, talk: Talk) -> Aligned:
    """Align a recording whose times are unknown, by the method that the user names, or by any.

    Raises as `align_recording`.
    """
    if times.common is None or not times.common.unknown:
        return Aligned(sources, times.timeline, times.common)
    common = align_recording(
        sources,
        times.timeline,
        times.common,
        options.align,
        sound_error_s=options.sound_error_s,
        rate_given=times.by_rate,
        talk=talk,
    )
    if not common.cameras:
        if may_be_triggered(sources):
            talk(
                f"{len(sources)} videos of equal length and rate: if one trigger or recorder took their "
                "frames, import again with --synchronized, which takes equal numbers as one instant"
            )
        return Aligned(sources, times.timeline, common)
    left = [source for source in sources if source.name in common.cameras]
    return Aligned(left, trim(with_common_times(times.timeline, common), talk), common)


def may_be_triggered(sources: Sequence[Source]) -> bool:
    """Return whether the sources are videos of equal counts and rates, which proves nothing."""
    videos = [source for source in sources if isinstance(source, Video)]
    lengths = {(len(video.numbers), round(video.fps, 2)) for video in videos}
    return len(videos) == len(sources) and len(lengths) == 1


def align_recording(
    sources: Sequence[Source],
    timeline: Timeline,
    unknown: CommonTimes,
    by: str,
    *,
    sound_error_s: float,
    rate_given: bool = False,
    talk: Talk,
) -> CommonTimes:
    """Align a recording; return the state of its times with each camera's offset, `unknown` without any.

    `by`: a method's name, none, or auto, which takes the smallest uncertainty for each pair of cameras. auto
    takes a result in doubt, see `AlignmentMethod.doubt`, only if another method confirms it. Cameras that
    cannot be aligned are not in the result, if at least two others can.

    `talk` receives what each method found for the cameras, unless the state's reason has it. `sound_error_s`
    (95 %): possible offset between two cameras' sounds while their images are simultaneous. `rate_given`:
    frames are timed by a rate, not by their videos, so sound has different times. Raises BadInputError if the
    requested method does not apply to these sources.
    """
    videos = [source for source in sources if isinstance(source, Video)]
    if by in ("none", MOTION) or len(videos) < len(sources):
        if by not in ("auto", "none", MOTION):
            raise BadInputError(f"--align {by} is for videos", hint="these are images: leave it out")
        return unknown
    methods = alignment_methods(by)
    timed = [name for name, method in methods.items() if method.of_video_times]
    if by in timed and rate_given:
        raise BadInputError(
            f"--align {by} takes the videos' own times", hint="--times video instead of --fps"
        )
    measured = {
        method: against
        for method, against in _measurements(methods, videos, timeline, sound_error_s).items()
        if not (method in timed and rate_given)
    }
    cameras = _largest_chain(
        [source.name for source in videos],
        lambda first, second: _most_accurate(first, second, measured, methods, trusting=by != "auto"),
    )
    said = {
        method: _describe(method, methods[method], against, cameras) for method, against in measured.items()
    }
    aligned = {name: camera for name, camera in cameras.items() if camera.offset_ns is not None}
    if len(aligned) < 2:
        reasons = [
            unknown.reason,
            *(f"not aligned by {method}: {text}" for method, text in said.items()),
            *([f"by {', '.join(timed)} not tried: that takes the videos' own times, not --fps"] * rate_given),
        ]
        return CommonTimes(state=unknown.state, reason=", ".join(reasons))
    for method, text in said.items():
        if text:
            talk(f"by {method}: {text}")
    for name in cameras.keys() - aligned.keys():
        talk(f"left out {name}: it cannot be aligned; --align none imports all, not synchronized")
    used = sorted({times.source for times in aligned.values()} - {REFERENCE})
    return CommonTimes(
        state="aligned", reason=f"by {' and '.join(used)}", reference=next(iter(aligned)), cameras=aligned
    )


def _measurements(
    methods: Mapping[str, AlignmentMethod[object]],
    videos: Sequence[Video],
    timeline: Timeline,
    sound_error_s: float,
) -> dict[str, Against]:
    """Return each method's measurement of two videos, by their cameras' names; the most trustworthy first."""
    by_name = {source.name: source for source in videos}
    starts_s = {
        name: min(frame.leader_ns for frame in frames) / 1e9 for name, frames in timeline.cameras().items()
    }

    def measurement(method: AlignmentMethod[object]) -> Against:
        return measure_pairs(
            lambda name: method.read(by_name[name].path, starts_s[name]),
            lambda one, other: method.match(one, other, sound_error_s),
        )

    return {name: measurement(method) for name, method in methods.items()}


def _largest_chain(names: Sequence[str], against: Against) -> dict[str, CameraTimes]:
    """Return the cameras' times against the first camera with which the most others can be aligned."""
    best: dict[str, CameraTimes] = {}
    known = 0
    for name in names:
        chain = chain_cameras([name, *(other for other in names if other != name)], against)
        aligned = sum(times.offset_ns is not None for times in chain.values())
        if aligned > known:
            best, known = chain, aligned
        if known == len(names):
            break
    return best


def _describe(
    name_of_method: str, method: AlignmentMethod[object], against: Against, cameras: Mapping[str, CameraTimes]
) -> str:
    """Describe one method's result for each camera against the first; equal reasons are listed once.

    Why it found nothing matters only for a camera that no other method aligned.
    """
    first, *others = cameras
    by_reason: dict[str, list[str]] = {}
    for name in others:
        text = (times := against(first, name)).reason
        if times.offset_ns is not None and cameras[name].offset_ns is None and (doubt := method.doubt(times)):
            text = (
                f"{times.offset_ns / 1e6:+.0f} ms, which nothing confirms: {doubt} "
                f"(if it is right: --align {name_of_method})"
            )
        elif times.offset_ns is not None:
            bar_ms = (times.uncertainty_ns or 0) / 1e6
            agrees = cameras[name].offset_ns is None or _agree(times, cameras[name])
            differs = "" if agrees else ", not taken: others differ"
            text = (
                f"{times.offset_ns / 1e6:+.1f} ± {bar_ms:.1f} ms{differs}"
                f"{times.reason and f', {times.reason}'}"
            )
        elif cameras[name].offset_ns is not None:
            continue
        by_reason.setdefault(text, []).append(name)
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in by_reason.items())


def _most_accurate(
    first: str,
    second: str,
    measured: Mapping[str, Against],
    methods: Mapping[str, AlignmentMethod[object]],
    *,
    trusting: bool,
) -> CameraTimes:
    """Return a pair's offset with the smallest uncertainty that no more trustworthy method contradicts.

    Results in doubt come after all others and, unless `trusting`, need one that agrees. The rate is the most
    accurate one of the methods that are not contradicted.
    """
    by_method = {method: against(first, second) for method, against in measured.items()}
    doubtful = {
        method for method, times in by_method.items() if not trusting and methods[method].doubt(times)
    }
    consistent: list[CameraTimes] = []
    for method in sorted(by_method, key=lambda method: method in doubtful):
        of = by_method[method]
        if of.offset_ns is not None and all(_agree(of, other) for other in consistent):
            consistent.append(of)
    proven = len(consistent) > 1 or any(
        times in consistent for method, times in by_method.items() if method not in doubtful
    )
    if not consistent or not proven:
        return CameraTimes(reason="; ".join(times.reason for times in by_method.values() if times.reason))
    best = min(consistent, key=lambda one: one.uncertainty_ns or 0)
    rate = min(consistent, key=lambda one: one.rate_uncertainty_ppm or 0.0)
    return replace(best, rate_ppm=rate.rate_ppm, rate_uncertainty_ppm=rate.rate_uncertainty_ppm)


def _agree(one: CameraTimes, other: CameraTimes) -> bool:
    """Return whether two measurements of a camera are compatible, at the epoch of the first."""
    at_ns = one.epoch_local_ns
    apart_ns = abs(one.leader_from_local(at_ns) - other.leader_from_local(at_ns))
    return apart_ns <= (one.uncertainty_at_ns(at_ns) or 0) + (other.uncertainty_at_ns(at_ns) or 0)


def heard_together(one: Path, other: Path) -> bool:
    """Return whether two videos have the same sound, at any offset; False without the method `sound`."""
    try:
        (method,) = alignment_methods("sound").values()
        return method.match(method.read(one, 0.0), method.read(other, 0.0), 0.0).offset_ns is not None
    except (BadInputError, NotAvailableError):
        return False


def with_common_times(timeline: Timeline, common: CommonTimes) -> Timeline:
    """Return a timeline of the cameras with common times, converted to these and matched again."""
    cameras = {
        name: [_at_common_time(frame, common.cameras[name]) for frame in frames]
        for name, frames in timeline.cameras().items()
        if name in common.cameras
    }
    return timeline_by_times("the recording", cameras)


def _at_common_time(frame: TimedFrame, times: CameraTimes) -> TimedFrame:
    own_ns = frame.leader_ns if frame.local_ns is None else frame.local_ns
    further = {**frame.further, "uncertainty_ns": times.uncertainty_at_ns(own_ns)}
    return dataclasses.replace(
        frame, leader_ns=times.leader_from_local(own_ns), local_ns=own_ns, further=further
    )
