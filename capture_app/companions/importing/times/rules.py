"""Rules that make a recording's times: the first that applies makes them and says what is known of them."""

import calendar
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from functools import partial
from itertools import combinations, islice
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.times.tables import Table, name_tables, timeline_by_tables
from capture_app.session.format.camera_labels import require_camera
from capture_app.session.format.common_times import CommonTimes, TimesState
from capture_app.session.importing.frame_matching import (
    Instant,
    TimedFrame,
    Timeline,
    Times,
    describe_times,
    require_overlap,
    timeline_by_times,
)
from capture_app.session.importing.recording_sources import (
    FOLDER,
    Images,
    Layout,
    Numbers,
    Source,
    Video,
    exif_time_ns,
    labels_of,
    name_time_ns,
    states_zone,
    unix_time_ns,
)

ASSUMED_FPS = 30.0
"""Assumed rate of images that are matched by their numbers, frames/s."""
BY_NUMBERS = "; frames are matched by their numbers, so later ones are matched wrongly: take --times video"
EQUAL_NUMBERS = "frames of equal number are taken as of one instant"
BY_PLACE = (
    "frames are paired by their place in each folder, as their names have no common number: "
    "this is right only if no camera lacks a frame"
)
OWN_BEGINNING = "each video counts from its own beginning"
OTHER_FPS = 0.01
"""Relative difference of two frame rates that are not the same one, such as 25 and 24; 29.97 is 30."""


_HOUR_NS = 3_600_000_000_000
_SUMMER_ENDS = {4: range(1, 8), 10: range(25, 32), 11: range(1, 8)}
"""Days of the month whose Sunday may end summer time: in Australia, Europe and North America, by month.

Hour 1 of local time is then twice in London and New York, 2 in Berlin and Sydney, 3 in Helsinki.
"""


@dataclass(frozen=True, slots=True)
class _Recording:
    """What the rules decide by."""

    sources: Sequence[Source]
    options: ImportOptions
    layout: Layout

    @property
    def videos(self) -> list[Video]:
        return [source for source in self.sources if isinstance(source, Video)]

    @property
    def of_other_rate(self) -> list[Video]:
        fps = self.options.fps
        return [video for video in self.videos if fps and video.fps and abs(fps / video.fps - 1) > OTHER_FPS]

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


def make_times(layout: Layout, options: ImportOptions) -> Times:
    """Compute every frame's time, match frames to instants, and state what is known of these times.

    The notes are what was assumed, and the gaps in the times. Raises BadInputError if there is no source of
    times, more than one, or if cameras' times never meet.
    """
    recording, sources = _Recording(layout.sources, options, layout), layout.sources
    shifts_ns = {
        require_camera(name, labels_of(sources), "--time-shift-ms"): round(ms * 1e6)
        for name, ms in options.offsets_ms.items()
    }
    _check_options(recording)
    rule = next(rule for rule in RULES if rule.applies(recording))
    made, notes = rule.make(recording)
    timeline = made if isinstance(made, Timeline) else None
    if timeline is None or options.offsets_ms:
        frames = made.cameras() if isinstance(made, Timeline) else made
        shifted = {
            name: [replace(frame, leader_ns=frame.leader_ns + shifts_ns.get(name, 0)) for frame in own]
            for name, own in frames.items()
        }
        timeline = timeline_by_times("the recording", shifted)
    require_overlap(timeline)
    common = None if len(sources) < 2 else _known(rule.state, rule.sentence(recording), options)
    gaps = () if layout.record else describe_gaps(sources, timeline, by_numbers=rule.by_rate)
    return Times(timeline, common, rule.by_rate, (*notes, *gaps))


def _known(state: TimesState, sentence: str, options: ImportOptions) -> CommonTimes:
    """Return the state of a rule's times, with the user's corrections and uncertainty."""
    if options.offsets_ms:
        reason = "--time-shift-ms" if state == "unknown" else f"{sentence}; shifted by --time-shift-ms"
        return CommonTimes(state="given", reason=reason)
    if state == "unknown" and options.uncertainty_ms is not None:
        return CommonTimes(state="given", reason="--uncertainty-ms")
    return CommonTimes(state=state, reason=sentence)


def _check_options(recording: _Recording) -> None:
    options = recording.options
    if recording.layout.record and options.offsets_ms:
        raise BadInputError(
            f"{recording.layout.path} has the times of its session, which --time-shift-ms would contradict",
            hint="import it without, and give reconstruct --time-shift-ms",
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
    rates = [video.fps for video in recording.videos]
    differing = recording.of_other_rate
    # Videos of one rate, which is not the user's, may be slow motion.
    if differing and not options.synchronized and max(rates) > (1 + OTHER_FPS) * min(rates):
        said = ", ".join(f"{video.path.name} {video.fps:.4g}" for video in differing)
        raise BadInputError(
            f"the files state other rates than {options.fps:g} frames a second: {said}",
            hint="leave out --fps, which takes the videos' own times; --synchronized if one clock "
            "triggered all frames",
        )


def _by_given_rate(recording: _Recording) -> _Made:
    fps, notes = recording.options.fps or ASSUMED_FPS, []
    for video in recording.of_other_rate:
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


def _by_images(recording: _Recording, read: Callable[[Path], int], *, is_local: bool = True) -> _Made:
    """Return the times that `read` finds in the images' names or contents; `is_local`: of an unknown zone."""
    frames = {}
    for source in recording.sources:
        if not isinstance(source, Images) or source.kind != FOLDER:
            raise BadInputError(
                f"{source.path} is not a folder of images", hint="--times video takes videos' times"
            )
        frames[source.name] = [TimedFrame(number, read(file)) for number, file in enumerate(source.files)]
    return frames, _describe_double_hour(frames) if is_local else ()


def _has_unix_times(recording: _Recording) -> bool:
    """Return whether the names of all images have Unix times."""
    images = (source for source in recording.sources if isinstance(source, Images))
    return all(unix_time_ns(file) is not None for source in images for file in source.files)


def _describe_double_hour(frames: _Frames) -> list[str]:
    """Return a line if local times may be of the hour that the end of summer time has twice."""
    hours = {frame.leader_ns // _HOUR_NS for own in frames.values() for frame in own}
    dates = (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(hours=hour) for hour in sorted(hours))
    said = (
        f"summer time may end on {date:%Y-%m-%d}: local time may have the hour from {date:%H:%M} twice; "
        "if a camera's times are an hour ahead, --time-shift-ms CAMERA=-3600000 corrects them"
        for date in dates
        if date.weekday() == calendar.SUNDAY
        and date.day in _SUMMER_ENDS.get(date.month, ())
        and 1 <= date.hour <= 3
    )
    return [*islice(said, 1)]


def _by_exif(recording: _Recording) -> _Made:
    """Return the images' times in EXIF, by UTC if all cameras state how far ahead of it they are."""
    folders = [source for source in recording.sources if isinstance(source, Images)]
    zoned = all(source.kind == FOLDER and states_zone(source.files[0]) for source in folders)
    return _by_images(recording, partial(exif_time_ns, zoned=zoned), is_local=not zoned)


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


def _embedded(recording: _Recording) -> _Frames:
    return {
        source.name: times for source in recording.sources if (times := source.embedded_times()) is not None
    }


def _refuse(recording: _Recording) -> _Made:
    """Raise BadInputError: no rule gives these images times."""
    folders = [source for source in recording.sources if isinstance(source, Images)]
    names = ", ".join(labels_of(folders).values())
    if len(folders) == len(recording.sources) and all(map(_named_by_time, folders)):
        raise BadInputError(
            f"the images of {names} are named by times, which may be of one clock or not",
            hint="if one clock gave them, take them: --times name",
        )
    raise BadInputError(
        f"the images of {names} have no times",
        hint="add their rate, --fps, or a table, --timestamps; if equal numbers are of one instant: "
        "--synchronized; if they have times in EXIF: --times exif",
    )


def _named_by_time(source: Images) -> bool:
    with suppress(BadInputError):
        times_ns = [name_time_ns(file) for file in source.files[:2]]
        return source.kind == FOLDER and times_ns == sorted(set(times_ns))
    return False


def _say_tables(tables: Sequence[Table]) -> str:
    return f"the table{'s' * (len(tables) > 1)} {', '.join(path.name for _, path in tables)}"


def describe_gaps(sources: Sequence[Source], timeline: Timeline, *, by_numbers: bool) -> Iterator[str]:
    """Yield a line for each camera that dropped or doubled frames, by its own times.

    A video's presentation times are described, where the timeline is `by_numbers` of their frames.
    """
    cameras = timeline.cameras()
    for source in sources:
        own_ns = source.own_times_ns() if isinstance(source, Video) and by_numbers else ()
        times_ns = own_ns or sorted(frame.leader_ns for frame in cameras.get(source.name, ()))
        if said := describe_times(times_ns):
            yield f"{source.label or source.name}: {said}{BY_NUMBERS if own_ns else ''}"


def times_by_rate(sources: Sequence[Source], fps: float) -> dict[str, list[TimedFrame]]:
    """Return the frames of each camera, 1/fps apart by their numbers; number 0 is at 0 ns.

    Raises BadInputError for an invalid rate.
    """
    period, numbers = _period_of(fps), _numbers(sources)
    return {
        name: [TimedFrame(index, round(number * period)) for index, number in enumerate(of)]
        for name, of in numbers.items()
    }


def timeline_by_rate(sources: Sequence[Source], fps: float) -> Timeline:
    """Match frames of equal number to one instant, 1/fps apart; the lowest number is at 0 ns.

    Raises BadInputError for an invalid rate, or if no two cameras share a number.
    """
    period, numbers = _period_of(fps), _numbers(sources)
    indices = {name: {number: index for index, number in enumerate(of)} for name, of in numbers.items()}
    every = sorted(set().union(*indices.values()))
    shared = [number for number in every if sum(number in index for index in indices.values()) > 1]
    if len(sources) > 1 and not shared:
        raise BadInputError(
            "no two cameras share a frame number",
            hint="frames of one instant need the same number in their file names; else use --timestamps",
        )
    times_ns = {number: round((number - every[0]) * period) for number in every}
    instants = [
        Instant(at_ns, {name: TimedFrame(index[n], at_ns) for name, index in indices.items() if n in index})
        for n, at_ns in times_ns.items()
    ]
    return Timeline(instants, round(period), dict.fromkeys(indices, round(period)))


def _period_of(fps: float) -> Fraction:
    if not 0.001 <= fps <= 1e6:
        raise BadInputError(f"frame rate {fps:g} is out of range (0.001 to 1e6)", hint="for example --fps 60")
    return 1_000_000_000 / Fraction(str(fps))


def numbers_of_frames(sources: Sequence[Source]) -> dict[str, Sequence[int]] | None:
    """Return each camera's frame numbers; None if some camera has none, so that only the order counts."""
    names = {source.name: source.name_numbers for source in sources}
    numbers = frame_numbers(names) if all(names.values()) else None
    own = (numbers or {}).values()
    # In folders of their own, counters that never meet are each camera's own.
    folders = {source.path for source in sources if isinstance(source, Images)}
    apart = len(folders) == len(own) > 1 and not set.intersection(*map(set, own))
    whole = len({len(of) for of in own}) == 1 and all(max(of) - min(of) == len(of) - 1 for of in own)
    return None if apart and whole else numbers


def _numbers(sources: Sequence[Source]) -> Mapping[str, Sequence[int]]:
    return numbers_of_frames(sources) or {source.name: range(len(source.numbers)) for source in sources}


def frame_numbers(cameras: Mapping[str, Sequence[Numbers]]) -> dict[str, Sequence[int]] | None:
    """Return the frames' numbers by camera, given the numbers in their names; None if none counts frames.

    A number that is the same in all names of each camera does not count, such as a size. If several change,
    as hours and seconds do, frames are numbered by the order of all of them; if no two cameras then share a
    frame, by the one that two cameras share.
    """
    lengths = {name: {len(name) for name in names} for name, names in cameras.items()}
    if any(len(length) != 1 for length in lengths.values()):
        return None
    changing = {
        name: [k for k, values in enumerate(zip(*names, strict=True)) if len(set(values)) > 1]
        for name, names in cameras.items()
    }
    if len(set.union(*lengths.values())) == 1:
        together = sorted(set().union(*changing.values()))
        changing = dict.fromkeys(cameras, together)
    (width, *others) = {len(columns) for columns in changing.values()}
    if others or not width:
        return None
    digits_of = {
        name: [tuple(of[k] for k in changing[name]) for of in names] for name, names in cameras.items()
    }
    single: list[dict[str, list[Numbers]]] = [
        {name: [(name[k],) for name in names] for name, names in digits_of.items()} for k in range(width)
    ]
    tried = (
        [digits_of] if _shared(digits_of) else [digits for digits in single if _shared(digits)] or [digits_of]
    )
    usable = [trial for trial in tried if all(len(set(names)) == len(names) for names in trial.values())]
    if len(usable) != 1:
        return None
    (digits_of,) = usable
    if all(len(name) == 1 for names in digits_of.values() for name in names):
        return {name: [number for (number,) in names] for name, names in digits_of.items()}
    order = {word: n for n, word in enumerate(sorted(set().union(*digits_of.values())))}
    return {name: [order[name] for name in names] for name, names in digits_of.items()}


def _shared(cameras: Mapping[str, Sequence[Numbers]]) -> bool:
    return any(set(first) & set(other) for first, other in combinations(cameras.values(), 2))


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
        lambda one: one.options.fps is not None,
        _by_given_rate,
        "unknown",
        lambda one: OWN_BEGINNING,
        by_rate=True,
    ),
    Rule(
        lambda one: one.options.times == "name",
        lambda one: _by_images(one, name_time_ns, is_local=not _has_unix_times(one)),
        "given",
        lambda one: "the times in file names are taken as of one clock",
    ),
    Rule(
        lambda one: one.options.times == "exif",
        _by_exif,
        "unknown",
        lambda one: "EXIF times are by each camera's own clock",
    ),
    Rule(lambda one: one.options.times == "video", _by_videos, "unknown", lambda one: OWN_BEGINNING),
    Rule(lambda one: one.options.synchronized, _by_numbers, "given", lambda one: one.numbers, by_rate=True),
    # What is beside the recording.
    Rule(
        lambda one: one.layout.timestamps,
        lambda one: timeline_by_tables(one.sources, one.layout.timestamps),
        "recorded",
        lambda one: _say_tables(one.layout.timestamps),
    ),
    Rule(
        lambda one: one.layout.timeline,
        lambda one: (one.layout.timeline or {}, ()),
        "recorded",
        lambda one: (
            f"times of {one.layout.times_of}" if one.layout.times_of else "the times that its program wrote"
        ),
    ),
    Rule(
        lambda one: len(_embedded(one)) == len(one.sources),
        lambda one: (_embedded(one), ()),
        "recorded",
        lambda one: "the recording's own table of times",
    ),
    Rule(
        lambda one: one.layout.same_frames and not one.options.offsets_ms,
        _by_numbers,
        "given",
        lambda one: one.numbers,
        by_rate=True,
    ),
    Rule(lambda one: len(one.videos) == len(one.sources), _by_videos, "unknown", lambda one: OWN_BEGINNING),
    Rule(
        lambda one: all(
            isinstance(source, Images) and source.kind == FOLDER and len(source.files) == 1
            for source in one.sources
        ),
        lambda one: ({source.name: [TimedFrame(0, 0)] for source in one.sources}, ()),
        "unknown",
        lambda one: "these images have no times",
    ),
    Rule(lambda one: True, _refuse, "unknown", lambda one: ""),
)
"""All rules, in the order in which they are tried."""
