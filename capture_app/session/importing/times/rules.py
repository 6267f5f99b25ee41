"""Rules that make a recording's times: the first that applies makes them and says what is known of them."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.text import Talk
from capture_app.session.format.common_times import CommonTimes, TimesState
from capture_app.session.importing.embedded_times import TimeSource, exif_time_ns, name_time_ns
from capture_app.session.importing.frame_gaps import describe_gaps
from capture_app.session.importing.frame_matching import (
    TimedFrame,
    Timeline,
    require_overlap,
    timeline_by_times,
)
from capture_app.session.importing.recording_sources import FOLDER, Images, Layout, Source, Video
from capture_app.session.importing.times.rate_or_table import (
    Table,
    numbers_of_frames,
    timeline_by_rate,
    timeline_by_tables,
    times_by_rate,
)
from capture_app.session.importing.times.tables import name_tables

ASSUMED_FPS = 30.0
"""Assumed rate of images that are matched by their numbers, frames/s."""
EQUAL_NUMBERS = "frames of equal number are taken as of one instant"
BY_PLACE = (
    "frames are paired by their place in each folder, as their names have no common number: "
    "this is right only if no camera lacks a frame"
)
OWN_BEGINNING = "each video counts from its own beginning"
OTHER_FPS = 0.01
"""Relative difference of two frame rates that are not the same one, such as 25 and 24; 29.97 is 30."""


@dataclass(frozen=True, kw_only=True)
class TimeOptions:
    """User's options for the times of an import."""

    fps: float | None = None
    """Frame rate, frames/s."""
    timestamps: Sequence[Table] = ()
    times: TimeSource = "auto"
    synchronized: bool = False
    """Whether frames of equal number belong to one instant; without a rate, videos use their own."""
    offsets_ms: Mapping[str, float] = field(default_factory=dict)
    """Offset that converts a camera's own times to the rig's, ms, by camera name."""
    uncertainty_ms: float | None = None
    """95 % uncertainty of the times."""

    @property
    def states_times(self) -> bool:
        """Whether the user specified the source of the times."""
        return self.synchronized or self.fps is not None or bool(self.timestamps) or self.times != "auto"


@dataclass(frozen=True, slots=True)
class Times:
    """Times of a recording's frames, and what is known of them; `common` is None for a single camera."""

    timeline: Timeline
    common: CommonTimes | None
    by_rate: bool
    """Whether a rate gives the times, instead of the frames' own ones."""


@dataclass(frozen=True, slots=True)
class _Recording:
    """What the rules decide by."""

    sources: Sequence[Source]
    options: TimeOptions
    layout: Layout

    @property
    def videos(self) -> list[Video]:
        return [source for source in self.sources if isinstance(source, Video)]

    @property
    def numbers(self) -> str:
        return BY_PLACE if numbers_of_frames(self.sources) is None else EQUAL_NUMBERS


_Frames = Mapping[str, Sequence[TimedFrame]]
_Made = tuple[Timeline | _Frames, Sequence[str]]
"""A timeline, or the frames of each camera to match by their times; and notes."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A way to make times: when it applies, how, what is then known of them, and the sentence about it."""

    applies: Callable[[_Recording], object]
    make: Callable[[_Recording], _Made]
    state: TimesState
    sentence: Callable[[_Recording], str]
    by_rate: bool = False


def make_times(layout: Layout, options: TimeOptions, talk: Talk) -> Times:
    """Compute every frame's time, match frames to instants, and state what is known of these times.

    `talk` receives the sources' notes, what was assumed, and the gaps in the times. Raises BadInputError if
    there is no source of times, more than one, or if cameras' times never meet.
    """
    recording, sources = _Recording(layout.sources, options, layout), layout.sources
    _check_options(recording)
    rule = next(rule for rule in RULES if rule.applies(recording))
    made, notes = rule.make(recording)
    timeline = made if isinstance(made, Timeline) else None
    if timeline is None or options.offsets_ms:
        frames = made.cameras() if isinstance(made, Timeline) else made
        timeline = timeline_by_times("the recording", _shifted(frames, options.offsets_ms))
    require_overlap(timeline)
    common = None if len(sources) < 2 else _known(rule.state, rule.sentence(recording), options)
    gaps = () if layout.record else describe_gaps(sources, timeline, by_numbers=rule.by_rate)
    for note in (*filter(None, (source.note for source in sources)), *notes, *gaps):
        talk(note)
    return Times(timeline, common, rule.by_rate)


def _known(state: TimesState, sentence: str, options: TimeOptions) -> CommonTimes:
    """Return the state of a rule's times, with the user's corrections and uncertainty."""
    if options.offsets_ms:
        told = "--time-shift-ms" if state == "unknown" else f"{sentence}; shifted by --time-shift-ms"
        return CommonTimes(state="given", reason=told)
    if state == "unknown" and options.uncertainty_ms is not None:
        return CommonTimes(state="given", reason="--uncertainty-ms")
    return CommonTimes(state=state, reason=sentence)


def _check_options(recording: _Recording) -> None:
    options, names = recording.options, [source.name for source in recording.sources]
    if unknown := [name for name in options.offsets_ms if name not in names]:
        raise BadInputError(
            f"--time-shift-ms names {unknown[0]}, which the recording lacks",
            hint=f"it has {', '.join(names)}",
        )
    stated = [options.fps is not None, bool(options.timestamps), options.times != "auto"]
    if sum(stated) > 1:
        raise BadInputError(
            "give either the rate, --fps, or a table of times, --timestamps, or --times",
            hint="leave out all of them but one",
        )
    others = {
        "--timestamps": options.timestamps,
        "--times": options.times != "auto",
        "--time-shift-ms": options.offsets_ms,
    }
    if options.synchronized and (other := next((name for name, given in others.items() if given), "")):
        raise BadInputError(
            f"--synchronized pairs frames of equal number, {other} pairs them by their times",
            hint=f"leave out --synchronized, or {other}",
        )
    if options.fps is not None:
        _check_rates(recording.videos, options.fps, synchronized=options.synchronized)


def _shifted(cameras: _Frames, offsets_ms: Mapping[str, float]) -> dict[str, list[TimedFrame]]:
    """Return the frames with the user's shift added to their times."""
    return {
        name: [
            replace(frame, leader_ns=frame.leader_ns + round(offsets_ms.get(name, 0.0) * 1e6))
            for frame in frames
        ]
        for name, frames in cameras.items()
    }


def _check_rates(videos: Sequence[Video], fps: float, *, synchronized: bool) -> None:
    """Raise BadInputError if videos state other rates than the user's, and not one of their own."""
    rates = [video.fps for video in videos]
    if (others := _of_other_rate(videos, fps)) and not synchronized and _differ(rates):
        said = ", ".join(f"{video.path.name} {video.fps:.4g}" for video in others)
        raise BadInputError(
            f"the files state other rates than {fps:g} frames a second: {said}",
            hint="leave out --fps, which takes the videos' own times; --synchronized if one clock "
            "triggered all frames",
        )


def _differ(rates: Sequence[float]) -> bool:
    return max(rates) > (1 + OTHER_FPS) * min(rates)


def _of_other_rate(videos: Sequence[Video], fps: float) -> list[Video]:
    return [video for video in videos if video.fps and abs(fps / video.fps - 1) > OTHER_FPS]


def _by_given_rate(recording: _Recording) -> _Made:
    fps = recording.options.fps or ASSUMED_FPS
    notes = []
    for video in _of_other_rate(recording.videos, fps):
        lengths = " become ".join(f"{len(video.numbers) / rate:.1f} s" for rate in (video.fps, fps))
        notes.append(f"{video.path.name} states {video.fps:.4g} frames a second: with {fps:g}, its {lengths}")
    by_rate = times_by_rate if recording.options.offsets_ms else timeline_by_rate
    return by_rate(recording.sources, fps), notes


def _by_numbers(recording: _Recording) -> _Made:
    """Match frames of equal number, at the videos' highest rate; images are at an assumed one."""
    videos = recording.videos
    if not videos:
        notes = [f"{ASSUMED_FPS:g} frames a second are assumed: --fps says otherwise"]
        return timeline_by_rate(recording.sources, ASSUMED_FPS), notes
    slow, fast = (end(videos, key=lambda one: one.fps) for end in (min, max))
    notes = []
    # Over half a frame in its length.
    if (fast.fps - slow.fps) * len(slow.numbers) / slow.fps >= 0.5:
        notes.append(
            f"{slow.path.name} has {slow.fps:.4g} frames a second and {fast.path.name} {fast.fps:.4g}: with "
            f"--synchronized they are a frame apart after {1 / (fast.fps - slow.fps):.0f} s; "
            "leave it out unless one clock triggered both"
        )
    return timeline_by_rate(recording.sources, fast.fps), notes


def _by_images(recording: _Recording, read: Callable[[Path], int]) -> _Made:
    """Return the times that `read` finds in the images' names or contents."""
    frames = {}
    for source in recording.sources:
        if not isinstance(source, Images) or source.kind != FOLDER:
            raise BadInputError(
                f"{source.path} is not a folder of images", hint="--times video takes videos' times"
            )
        frames[source.name] = [TimedFrame(number, read(file)) for number, file in enumerate(source.files)]
    return frames, ()


def _by_videos(recording: _Recording) -> _Made:
    """Return the videos' own times, or times by their rate where a file has none."""
    frames, notes = {}, []
    for source in recording.sources:
        if not isinstance(source, Video):
            raise BadInputError(
                f"{source.path} is not a video", hint="--times name or exif takes images' times"
            )
        own_ns = source.own_times_ns()
        frames[source.name] = [TimedFrame(number, at_ns) for number, at_ns in enumerate(own_ns)]
        if not own_ns:
            frames |= times_by_rate([source], source.fps)
            notes.append(
                f"{source.path.name} has no times of its own: {source.fps:g} frames a second are assumed"
            )
    return frames, notes


def _by_program(recording: _Recording) -> _Made:
    assert recording.layout.timeline is not None
    return recording.layout.timeline, ()


def _embedded(recording: _Recording) -> _Frames:
    return {
        source.name: times for source in recording.sources if (times := source.embedded_times()) is not None
    }


def _refuse(recording: _Recording) -> _Made:
    """Raise BadInputError: no rule gives these images times."""
    folders = [source for source in recording.sources if isinstance(source, Images)]
    names = ", ".join(source.name for source in folders)
    if len(folders) == len(recording.sources) and all(map(_named_by_time, folders)):
        raise BadInputError(
            f"the images of {names} are named by times, which may be of one clock or not",
            hint="if one clock gave them, take them: --times name",
        )
    raise BadInputError(
        f"the images of {names} have no times",
        hint="add their rate, --fps, or a table, --timestamps; if they have times in EXIF: --times exif",
    )


def _named_by_time(source: Images) -> bool:
    with suppress(BadInputError):
        times_ns = [name_time_ns(file) for file in source.files[:2]]
        return source.kind == FOLDER and times_ns == sorted(set(times_ns))
    return False


def _is_photo(source: Source) -> bool:
    return isinstance(source, Images) and source.kind == FOLDER and len(source.files) == 1


def _say(text: str) -> Callable[[_Recording], str]:
    return lambda recording: text


def _say_tables(tables: Sequence[Table]) -> str:
    return f"the table{'s' * (len(tables) > 1)} {', '.join(path.name for _, path in tables)}"


RULES = (
    # What the user states.
    Rule(
        lambda one: one.options.timestamps,
        lambda one: timeline_by_tables(one.sources, name_tables(one.options.timestamps, one.sources)),
        "recorded",
        lambda one: _say_tables(one.options.timestamps),
    ),
    Rule(
        lambda one: one.options.fps is not None and (one.options.synchronized or not one.videos),
        _by_given_rate,
        "given",
        lambda one: one.numbers,
        by_rate=True,
    ),
    # The rate of videos does not determine when each started.
    Rule(
        lambda one: one.options.fps is not None, _by_given_rate, "unknown", _say(OWN_BEGINNING), by_rate=True
    ),
    Rule(
        lambda one: one.options.times == "name",
        lambda one: _by_images(one, name_time_ns),
        "given",
        _say("the times in file names are taken as of one clock"),
    ),
    Rule(
        lambda one: one.options.times == "exif",
        lambda one: _by_images(one, exif_time_ns),
        "unknown",
        _say("EXIF times are by each camera's own clock"),
    ),
    Rule(lambda one: one.options.times == "video", _by_videos, "unknown", _say(OWN_BEGINNING)),
    Rule(lambda one: one.options.synchronized, _by_numbers, "given", lambda one: one.numbers, by_rate=True),
    # What lies with the recording.
    Rule(
        lambda one: one.layout.timestamps,
        lambda one: timeline_by_tables(one.sources, one.layout.timestamps),
        "recorded",
        lambda one: _say_tables(one.layout.timestamps),
    ),
    Rule(
        lambda one: one.layout.timeline,
        _by_program,
        "recorded",
        lambda one: (
            f"times of {one.layout.times_of}" if one.layout.times_of else "the times that its program wrote"
        ),
    ),
    Rule(
        lambda one: len(_embedded(one)) == len(one.sources),
        lambda one: (_embedded(one), ()),
        "recorded",
        _say("the recording's own table of times"),
    ),
    Rule(
        lambda one: one.layout.same_frames and not one.options.offsets_ms,
        _by_numbers,
        "given",
        lambda one: one.numbers,
        by_rate=True,
    ),
    Rule(lambda one: len(one.videos) == len(one.sources), _by_videos, "unknown", _say(OWN_BEGINNING)),
    Rule(
        lambda one: all(map(_is_photo, one.sources)),
        lambda one: ({source.name: [TimedFrame(0, 0)] for source in one.sources}, ()),
        "unknown",
        _say("these images have no times"),
    ),
    Rule(lambda one: True, _refuse, "unknown", _say("")),
)
"""All rules, in the order in which they are tried."""
