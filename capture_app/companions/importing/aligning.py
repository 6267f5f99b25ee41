"""Alignment of videos without common times, by methods that are plugins: sound, flashes, timecode, GPS."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from msgspec.structs import replace

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.alignment.alignment_method import AlignmentMethod, alignment_methods
from capture_app.session.alignment.clock_line import Against, chain_cameras, measure_pairs
from capture_app.session.format.common_times import REFERENCE, CameraTimes, CommonTimes
from capture_app.session.importing.frame_matching import Instant, Timeline, Times, trim, with_common_times
from capture_app.session.importing.recording_sources import Half, Source, Video, labels_of

_Value = TypeVar("_Value")
MOTION = "motion"
"""Alignment by what moves, which is the reconstruction's, on the session as it is written."""


@dataclass(frozen=True, slots=True)
class Aligned:
    """The cameras that have common times, if any have; the timeline by these, and what is known of it."""

    sources: Sequence[Source]
    timeline: Timeline
    common: CommonTimes | None
    notes: Sequence[str] = ()


def align_times(sources: Sequence[Source], times: Times, options: ImportOptions) -> Aligned:
    """Align a recording whose times are unknown, by the method that the user names, or by any.

    Cameras that cannot be aligned are left out, if at least two others can. The notes are what each method
    found for the cameras, unless the state's reason has it. Raises as `_measure`.
    """
    if times.common is None or not times.common.unknown:
        return Aligned(sources, times.timeline, times.common)
    common, notes = _measure(sources, times, times.common, options)
    if common.cameras:
        left = [source for source in sources if source.name in common.cameras]
        timeline, beside = trim(with_common_times(times.timeline, common))
        return Aligned(left, timeline, common, [*notes, *filter(None, [beside])])
    videos = [source for source in sources if isinstance(source, Video)]
    lengths = {(len(video.numbers), round(video.fps, 2)) for video in videos}
    # Equal counts and rates prove nothing.
    if len(videos) == len(sources) and len(lengths) == 1:
        notes.append(
            f"{len(sources)} videos of equal length and rate: if one trigger or recorder took their "
            "frames, import again with --synchronized, which takes equal numbers as one instant"
        )
    return Aligned(sources, times.timeline, common, notes)


def split_views(aligned: Aligned) -> Aligned:
    """Return a recording whose cameras are two each: the views side by side in each of their pictures."""
    sides = {"left": False, "right": True}

    def both(values: Mapping[str, _Value]) -> dict[str, _Value]:
        return {f"{name}-{side}": value for name, value in values.items() for side in sides}

    sources = [
        Half(source, f"{source.name}-{side}", right=right)
        for source in aligned.sources
        for side, right in sides.items()
    ]
    timeline = aligned.timeline
    instants = [Instant(one.leader_ns, both(one.frames), both(one.why_missing)) for one in timeline.instants]
    timeline = Timeline(instants, timeline.period_ns, both(timeline.camera_periods_ns))
    common = aligned.common or CommonTimes(state="recorded", reason="both views are in each picture")
    if common.cameras:
        reference = f"{common.reference}-{next(iter(sides))}"
        common = replace(common, reference=reference, cameras=both(common.cameras))
    return Aligned(sources, timeline, common, aligned.notes)


def _measure(
    sources: Sequence[Source], times: Times, unknown: CommonTimes, options: ImportOptions
) -> tuple[CommonTimes, list[str]]:
    """Return the state of a recording's times with each camera's offset, `unknown` without any; and notes.

    auto takes the smallest uncertainty for each pair of cameras, and a result in doubt, see
    `AlignmentMethod.doubt`, only if another method confirms it. Raises BadInputError if the requested method
    does not apply to these sources.
    """
    by = options.align
    videos = [source for source in sources if isinstance(source, Video)]
    if by in ("none", MOTION) or len(videos) < len(sources):
        if by not in ("auto", "none", MOTION):
            raise BadInputError(f"--align {by} is for videos", hint="these are images: leave it out")
        return unknown, []
    methods = alignment_methods(by)
    timed = [name for name, method in methods.items() if method.of_video_times]
    if by in timed and times.by_rate:
        raise BadInputError(
            f"--align {by} takes the videos' own times", hint="--times video instead of --fps"
        )
    measured = {
        method: against
        for method, against in _measurements(methods, videos, times.timeline, options.sound_error_s).items()
        if not (method in timed and times.by_rate)
    }
    cameras = _largest_chain(
        [source.name for source in videos],
        lambda first, second: _best_measured(first, second, measured, methods, trusting=by != "auto"),
    )
    labels = labels_of(videos)
    said = {
        method: _describe(method, methods[method], against, cameras, labels)
        for method, against in measured.items()
    }
    aligned = {name: camera for name, camera in cameras.items() if camera.offset_ns is not None}
    if len(aligned) < 2:
        reasons = [
            unknown.reason,
            *(f"not aligned by {method}: {text}" for method, text in said.items()),
            *[f"leave --align {by} out, and all other methods are tried"] * (by != "auto"),
            *(
                [f"by {', '.join(timed)} not tried: that takes the videos' own times, not --fps"]
                * times.by_rate
            ),
        ]
        return CommonTimes(state=unknown.state, reason=", ".join(reasons)), []
    notes = [f"by {method}: {text}" for method, text in said.items() if text]
    notes += [
        f"left out {labels[name]}: it cannot be aligned; --align none imports all, not synchronized"
        for name in cameras.keys() - aligned.keys()
    ]
    used = sorted({times.source for times in aligned.values()} - {REFERENCE})
    common = CommonTimes(
        state="aligned", reason=f"by {' and '.join(used)}", reference=next(iter(aligned)), cameras=aligned
    )
    return common, notes


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
    name_of_method: str,
    method: AlignmentMethod[object],
    against: Against,
    cameras: Mapping[str, CameraTimes],
    labels: Mapping[str, str],
) -> str:
    """Describe one method's result for each camera against the first; equal reasons are listed once.

    Why it found nothing matters only for a camera that no other method aligned.
    """
    first, *others = cameras
    by_reason: dict[str, list[str]] = {}
    for name in others:
        text = (times := against(first, name)).reason
        if (
            times.offset_ns is not None
            and cameras[name].offset_ns is None
            and (question := method.doubt(times))
        ):
            text = (
                f"{times.offset_ns / 1e6:+.0f} ms, which nothing confirms: {question} "
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
        by_reason.setdefault(text, []).append(labels[name])
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in by_reason.items())


def _best_measured(
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
