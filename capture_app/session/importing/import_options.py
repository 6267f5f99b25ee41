"""User's options for an import, and the times and the state of the clocks that follow from them."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.session.format.common_times import CommonTimes, TimesState
from capture_app.session.importing.calibrations import Fit
from capture_app.session.importing.embedded_times import (
    TimeSource,
    exif_time_ns,
    name_time_ns,
)
from capture_app.session.importing.frame_matching import TimedFrame, Timeline, timeline_by_times
from capture_app.session.importing.rate_or_table import (
    numbers_of_frames,
    timeline_by_rate,
    timeline_by_table,
    times_by_rate,
)
from capture_app.session.importing.recording_sources import FOLDER, Images, Source, Video

ASSUMED_FPS = 30.0
"""Assumed rate of images that are matched by their numbers, frames/s."""
EQUAL_NUMBERS = "frames of equal number are taken as of one instant"
BY_PLACE = (
    "frames are paired by their place in each folder, as their names have no common number: "
    "this is right only if no camera lacks a frame"
)
OTHER_FPS = 0.01
"""Relative difference of two frame rates that are not the same one, such as 25 and 24; 29.97 is 30."""
MAX_GAP_NS = 1_000_000_000
"""Maximum time between the end of one camera and the beginning of another in one recording."""
SOUND_M_PER_S = 343.0
SOUND_DISTANCE_M = 1.0
SOUND_DELAY_MS = 20.0
"""Assumed: there is no measurement of the cameras' sound delay."""


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """Options of an import: frame rate in frames/s or a table of times, and which instants to import."""

    fps: float | None = None
    timestamps: Path | None = None
    times: TimeSource = "auto"
    offsets_ms: Mapping[str, float] = field(default_factory=dict)
    """Offset that converts a camera's own times to the rig's, ms, by camera name."""
    synchronized: bool = False
    """Whether frames of equal number belong to one instant; without a rate, videos use their own."""
    uncertainty_ms: float | None = None
    """95 % uncertainty of the times, stated by the user."""
    known: Timeline | None = None
    """Times written by the program that made the recording."""
    known_of: str = ""
    """What these are times of, as `Layout.times_of`."""
    start: int = 0
    """First instant to import, counted from 0."""
    count: int | None = None
    every: int = 1
    png: bool = False
    """Store a video's frames as PNG instead of JPEG (quality 95)."""
    align: str = "auto"
    """Method that aligns a recording without common times: see `align_recording`."""
    sound_distance_m: float = SOUND_DISTANCE_M
    """Maximum difference between the cameras' distances to a sound, m."""
    sound_delay_ms: float = SOUND_DELAY_MS
    """Maximum difference between two cameras' delays from image to sound, ms (95 %)."""
    calibration: Sequence[str] = field(default_factory=tuple)
    """PATH or NAME=PATH, see `read_views`."""
    beside: Path | None = None
    """A calibration found beside the recording, used if it fits."""
    unit: str | None = None
    fit: Fit = "exact"
    note: str = ""
    recording: str | None = None
    """Name of one recording, if a program's folder has several."""

    @property
    def report_times(self) -> bool:
        """Whether the user specified the source of the times."""
        return self.fps is not None or self.timestamps is not None or self.times != "auto"


def make_timeline(sources: Sequence[Source], options: ImportOptions) -> Timeline:
    """Compute every frame's time and match frames to instants; each assumption is noted in its source.

    Raises BadInputError if there is no source of times, more than one, or if cameras' times never meet.
    """
    timeline = _timeline(sources, options)
    spans = {name: (frames[0].leader_ns, frames[-1].leader_ns) for name, frames in timeline.cameras().items()}
    for (first, span), (second, other) in combinations(spans.items(), 2):
        if (gap_ns := max(span[0], other[0]) - min(span[1], other[1])) > max(
            MAX_GAP_NS, 2 * timeline.period_ns
        ):
            raise BadInputError(
                f"the times of {first} and {second} never meet: {gap_ns / 1e9:.1f} s pass between them, and "
                f"{abs(span[0] - other[0]) / 1e9:.1f} s between their beginnings",
                hint="if each counts from its own start, give the difference: --time-shift-ms CAMERA=MS",
            )
    return timeline


def _timeline(sources: Sequence[Source], options: ImportOptions) -> Timeline:
    _check_options([source.name for source in sources], options)
    if options.fps is not None:
        _check_rates([source for source in sources if isinstance(source, Video)], options.fps, options)
    if options.timestamps is not None:
        return _shifted(timeline_by_table(sources, options.timestamps), options, str(options.timestamps))
    if options.fps is not None and not options.offsets_ms:
        return timeline_by_rate(sources, options.fps)
    if options.fps is not None:
        return _by_times("the recording", times_by_rate(sources, options.fps), options)
    if options.times != "auto":
        return _by_times(
            "the recording", {source.name: _own(source, options.times) for source in sources}, options
        )
    if options.known is not None:
        return _shifted(options.known, options, "the recording")
    recorded = {source.name: times for source in sources if (times := source.embedded_times()) is not None}
    complete = len(recorded) == len(sources)
    return _by_times("the recording", recorded, options) if complete else _by_videos(sources, options)


def _check_options(names: Sequence[str], options: ImportOptions) -> None:
    if unknown := [name for name in options.offsets_ms if name not in names]:
        raise BadInputError(
            f"--time-shift-ms names {unknown[0]}, which the recording lacks",
            hint=f"it has {', '.join(names)}",
        )
    if sum((options.fps is not None, options.timestamps is not None, options.times != "auto")) > 1:
        raise BadInputError(
            "give either the rate, --fps, or a table of times, --timestamps, or --times",
            hint="leave out all of them but one",
        )


def _check_rates(videos: Sequence[Video], fps: float, options: ImportOptions) -> None:
    """Note that videos state another rate than the user's. Raises BadInputError if they also differ."""
    others = [video for video in videos if video.fps and abs(fps / video.fps - 1) > OTHER_FPS]
    rates = [video.fps for video in videos]
    if others and not options.synchronized and max(rates) > (1 + OTHER_FPS) * min(rates):
        said = ", ".join(f"{video.path.name} {video.fps:.4g}" for video in others)
        raise BadInputError(
            f"the files state other rates than {fps:g} frames a second: {said}",
            hint="leave out --fps, which takes the videos' own times; --synchronized if one clock "
            "triggered all frames",
        )
    for video in others:
        lengths = " become ".join(f"{len(video.numbers) / rate:.1f} s" for rate in (video.fps, fps))
        note = f"{video.path.name} states {video.fps:.4g} frames a second: with {fps:g}, its {lengths}"
        video.note = "; ".join(filter(None, (video.note, note)))


def _by_videos(sources: Sequence[Source], options: ImportOptions) -> Timeline:
    """Return the times of files without a common clock: each video's own, with the user's corrections."""
    rates = {source.fps for source in sources if isinstance(source, Video)}
    if options.synchronized:
        _note_different_rates(sources)
        if not rates:
            sources[0].note = f"{ASSUMED_FPS:g} frames a second are assumed: --fps says otherwise"
        return timeline_by_rate(sources, max(rates, default=ASSUMED_FPS))
    if options.offsets_ms or all(isinstance(source, Video) for source in sources):
        return _by_times("the recording", {source.name: _own(source, "video") for source in sources}, options)
    if all(
        isinstance(source, Images) and source.kind == FOLDER and len(source.files) == 1 for source in sources
    ):
        return timeline_by_times("the recording", {source.name: [TimedFrame(0, 0)] for source in sources})
    folders = [source for source in sources if isinstance(source, Images) and source.kind == FOLDER]
    names = ", ".join(source.name for source in sources if isinstance(source, Images))
    if len(folders) == len(sources) and all(map(_named_by_time, folders)):
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
        return times_ns == sorted(set(times_ns))
    return False


def _note_different_rates(sources: Sequence[Source]) -> None:
    """Note in its source that a video's rate differs from another's by over half a frame in its length."""
    videos = [source for source in sources if isinstance(source, Video)]
    slow, fast = (end(videos, key=lambda one: one.fps, default=None) for end in (min, max))
    if slow is None or fast is None or (fast.fps - slow.fps) * len(slow.numbers) / slow.fps < 0.5:
        return
    slow.note = (
        f"{slow.path.name} has {slow.fps:.4g} frames a second and {fast.path.name} {fast.fps:.4g}: with "
        f"--synchronized they are a frame apart after {1 / (fast.fps - slow.fps):.0f} s; "
        "leave it out unless one clock triggered both"
    )


def _own(source: Source, times: TimeSource) -> list[TimedFrame]:
    """Return the frames of one source with the times in its own files."""
    if times == "video":
        if not isinstance(source, Video):
            raise BadInputError(
                f"{source.path} is not a video", hint="--times name or exif takes images' times"
            )
        of_video = source.use_embedded_times()
        if of_video:
            return [TimedFrame(number, at_ns) for number, at_ns in enumerate(of_video)]
        source.note = (
            f"{source.path.name} has no times of its own: {source.fps:g} frames a second are assumed"
        )
        return times_by_rate([source], source.fps)[source.name]
    if not isinstance(source, Images) or source.kind != FOLDER:
        raise BadInputError(
            f"{source.path} is not a folder of images", hint="--times video takes videos' times"
        )
    read = name_time_ns if times == "name" else exif_time_ns
    return [TimedFrame(number, read(file)) for number, file in enumerate(source.files)]


def _by_times(where: str, cameras: Mapping[str, Sequence[TimedFrame]], options: ImportOptions) -> Timeline:
    """Match frames by their times after adding the user's shift for each camera."""
    offsets_ns = {name: round(options.offsets_ms.get(name, 0.0) * 1e6) for name in cameras}
    shifted = {
        name: [replace(frame, leader_ns=frame.leader_ns + offsets_ns[name]) for frame in frames]
        for name, frames in cameras.items()
    }
    return timeline_by_times(where, shifted)


def _shifted(timeline: Timeline, options: ImportOptions, where: str) -> Timeline:
    """Return the timeline, matched again if the user shifts a camera's times."""
    return _by_times(where, timeline.cameras(), options) if options.offsets_ms else timeline


def clock_state(sources: Sequence[Source], options: ImportOptions) -> CommonTimes | None:
    """Return the state of the times that `make_timeline` computes; None for a single camera.

    The rate of videos does not determine when each started; the rate of numbered images does match them.
    """
    if len(sources) < 2:
        return None
    videos = any(isinstance(source, Video) for source in sources)
    by_program = options.known is not None and not options.report_times and not options.offsets_ms
    by_table = not options.report_times and all(source.embedded_times() is not None for source in sources)
    numbers = BY_PLACE if numbers_of_frames(sources) is None else EQUAL_NUMBERS
    table = options.timestamps and f"the table {options.timestamps.name}"
    rules: tuple[tuple[object, TimesState, str], ...] = (
        (table, "recorded", str(table)),
        (by_program, "recorded", options.known_of or "the times that its program wrote"),
        (options.synchronized, "given", numbers),
        (options.offsets_ms, "given", "--time-shift-ms"),
        (options.uncertainty_ms is not None, "given", "--uncertainty-ms"),
        (options.fps is not None and not videos, "given", numbers),
        (options.times == "name", "given", "the times in file names are taken as of one clock"),
        (by_table, "recorded", "the recording's own table of times"),
        (options.times == "exif", "unknown", "EXIF times are by each camera's own clock"),
        (not videos, "unknown", "these images have no times"),
        (True, "unknown", "each video counts from its own beginning"),
    )
    return next(CommonTimes(state=state, reason=reason) for applies, state, reason in rules if applies)
