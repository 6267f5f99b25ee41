"""Where a recording's times come from, by what the user says and what the recording has."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.importers.matching import TimedFrame, Timeline, timeline_by_times
from capture_app.session.importers.own_times import Times, exif_time_ns, has_video_times, name_time_ns
from capture_app.session.importers.sources import ImageFolder, Source, Video
from capture_app.session.importers.timing import timeline_by_rate, timeline_by_table, times_by_rate


@dataclass(frozen=True, slots=True)
class Clocks:
    """What is said of a recording's times: a rate in frames a second, a table, or where else they are."""

    fps: float | None = None
    timestamps: Path | None = None
    times: Times = Times.AUTO
    offsets_ms: Mapping[str, float] = field(default_factory=dict)
    same_frames: bool = False
    """Videos whose frames of the same number are of one instant, at their own rate."""


def make_timeline(sources: Sequence[Source], clocks: Clocks, talk: Callable[[str], None]) -> Timeline:
    """Find out when every frame was taken, and which belong together; assumptions are told to `talk`.

    Raises BadInputError where nothing tells, or more than one thing does.
    """
    names = [source.name for source in sources]
    for name in clocks.offsets_ms:
        if name not in names:
            raise BadInputError(
                f"--time-shift-ms names {name}, which the recording lacks", hint=f"it has {', '.join(names)}"
            )
    given = (clocks.fps is not None, clocks.timestamps is not None, clocks.times is not Times.AUTO)
    if sum(given) > 1:
        raise BadInputError("give either the rate, --fps, or a table of times, --timestamps, or --times")
    if clocks.timestamps is not None:
        return _shifted(timeline_by_table(sources, clocks.timestamps), clocks, str(clocks.timestamps))
    if clocks.fps is not None and not clocks.offsets_ms:
        return timeline_by_rate(sources, clocks.fps)
    if clocks.fps is not None:
        return _by_times("the recording", times_by_rate(sources, clocks.fps), clocks)
    if clocks.times is not Times.AUTO:
        frames = {source.name: _own(source, clocks.times, talk) for source in sources}
        return _by_times("the recording", frames, clocks)
    recorded = {source.name: times for source in sources if (times := source.own_times()) is not None}
    if len(recorded) == len(sources):
        for remark in filter(None, (source.remark for source in sources)):
            talk(remark)
        return _by_times("the recording", recorded, clocks)
    if clocks.same_frames or clocks.offsets_ms:
        return _by_videos(sources, clocks, talk)
    if all(isinstance(source, ImageFolder) and len(source.files) == 1 for source in sources):
        return timeline_by_times("the recording", {name: [TimedFrame(0, 0)] for name in names})
    raise _nothing_tells(sources)


def _by_videos(sources: Sequence[Source], clocks: Clocks, talk: Callable[[str], None]) -> Timeline:
    rates = {source.fps for source in sources if isinstance(source, Video)}
    if clocks.same_frames and rates:
        return timeline_by_rate(sources, max(rates))
    frames = {source.name: _own(source, Times.VIDEO, talk) for source in sources}
    return _by_times("the recording", frames, clocks)


def _nothing_tells(sources: Sequence[Source]) -> BadInputError:
    said = next((f"{s.path.name} says --fps {s.fps:g}; " for s in sources if isinstance(s, Video)), "")
    return BadInputError(
        "give either the rate, --fps, or a table of times, --timestamps",
        hint=f"{said}--times video, name or exif takes the frames' own",
    )


def _own(source: Source, times: Times, talk: Callable[[str], None]) -> list[TimedFrame]:
    """The frames of one source by times of their own."""
    if times is Times.VIDEO:
        if not isinstance(source, Video):
            raise BadInputError(f"{source.path} is no video", hint="--times video is for videos")
        if has_video_times():
            of_video = source.use_own_times()
            return [TimedFrame(number, at_ns) for number, at_ns in enumerate(of_video)]
        talk(f"{source.path.name}: a constant {source.fps:g} frames a second is assumed, for want of PyAV")
        return times_by_rate([source], source.fps)[source.name]
    if not isinstance(source, ImageFolder):
        raise BadInputError(f"{source.path} is no folder of images", hint=f"--times {times} is for images")
    read = name_time_ns if times is Times.NAME else exif_time_ns
    return [TimedFrame(number, read(file)) for number, file in enumerate(source.files)]


def _by_times(where: str, cameras: Mapping[str, Sequence[TimedFrame]], clocks: Clocks) -> Timeline:
    return timeline_by_times(
        where,
        {name: [_moved(frame, name, clocks) for frame in frames] for name, frames in cameras.items()},
    )


def _moved(frame: TimedFrame, name: str, clocks: Clocks) -> TimedFrame:
    return replace(frame, leader_ns=frame.leader_ns + round(clocks.offsets_ms.get(name, 0.0) * 1e6))


def _shifted(timeline: Timeline, clocks: Clocks, where: str) -> Timeline:
    """The same frames, matched anew where a camera's times are moved."""
    if not clocks.offsets_ms:
        return timeline
    cameras: dict[str, list[TimedFrame]] = {}
    for instant in timeline.instants:
        for name, frame in instant.frames.items():
            cameras.setdefault(name, []).append(frame)
    return _by_times(where, cameras, clocks)
