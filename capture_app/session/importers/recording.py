"""Recordings of other programs become sessions: frames matched in time, bytes kept as they are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from capture_app.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.errors import BadInputError
from capture_app.names import check_name
from capture_app.session.files.output_folder import OutputFolder, replaces_nothing
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage
from capture_app.session.importers.calibrations.reading import Fit, fit_calibration, read_views
from capture_app.session.importers.clock_state import clock_state
from capture_app.session.importers.embedded_times import TimeSource
from capture_app.session.importers.frame_matching import Instant, TimedFrame, Timeline, with_own_times
from capture_app.session.importers.layouts.recognition import Layout, recognize_layout
from capture_app.session.importers.open_sources import open_sources, split_name
from capture_app.session.importers.sources import Source
from capture_app.session.importers.time_source import TimeOptions, make_timeline
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.text import count

Progress = Callable[[int, int], None]
"""Called after each frame with the number of frames done and of all."""

Talk = Callable[[str], None]
"""Called with a line for each assumption."""

_NO_FRAME = "the recording has no frame of it"


@dataclass(frozen=True, kw_only=True)
class ImportOptions(TimeOptions):
    """How a recording is read: its rate or its table of times, which instants, and its calibration."""

    start: int = 0
    """The first instant that is taken, counted from 0."""
    count: int | None = None
    every: int = 1
    png: bool = False
    """Keep a video's frames as PNG instead of JPEG (quality 95)."""
    calibration: Sequence[str] = field(default_factory=tuple)
    """PATH or NAME=PATH, see `read_views`."""
    unit: str | None = None
    fit: Fit = Fit.EXACT
    note: str = ""


def import_recording(
    paths: Sequence[str],
    root: Path,
    name: str,
    options: ImportOptions,
    progress: Progress = lambda done, total: None,
    talk: Talk = lambda said: None,
) -> Session:
    """Write the session root/name from `NAME=PATH` cameras or one folder of them.

    Raises BadInputError for anything that cannot be used; no session is left behind then.
    """
    check_name(name, "session")
    layout = _layout(paths)
    if layout is not None:
        talk(f"{layout.videos} is of {layout.program}")
        paths, options = [str(layout.videos)], _with_layout(layout, options)
    sources = open_sources(paths, png=options.png)
    common = clock_state(sources, options)
    timeline = make_timeline(sources, options, talk)
    if common is not None and common.unknown:
        timeline = with_own_times(timeline)
        talk(f"{common.words}; docs/synchronizing.md says how to align it")
    instants = _chosen(timeline, options)
    names = [source.name for source in sources]
    places = [split_name(text) for text in options.calibration]
    views = read_views(places, names) if places else None
    with OutputFolder(root / name, replaces_nothing) as output, SessionWriter(output.folder, name) as writer:
        sizes = _write_images(writer, sources, instants, options, progress)
        cameras = [
            CameraRecord(
                name=source.name,
                facts=CameraFacts(
                    kind="imported",
                    model=source.kind,
                    width=sizes[source.name][0],
                    height=sizes[source.name][1],
                    period_ns=timeline.camera_periods_ns[source.name],
                    timestamp_source=TimestampSource.UNKNOWN,
                    phase_control=PhaseControl.NONE,
                ),
            )
            for source in sources
        ]
        if views is not None:
            writer.set_calibration(fit_calibration(views, sizes, unit=options.unit, fit=options.fit))
        times_ns = tuple(instant.leader_ns for instant in instants)
        burst = BurstRecord(instants_ns=times_ns, period_ns=timeline.period_ns, common_times=common)
        writer.finish(cameras, burst, _missing(writer, names, instants), "imported", options.note)
    return Session.open(root / name)


def _layout(paths: Sequence[str]) -> Layout | None:
    if len(paths) != 1:
        return None
    name, path = split_name(paths[0])
    return None if name else recognize_layout(path)


def _with_layout(layout: Layout, options: ImportOptions) -> ImportOptions:
    """The options, with what the folder knows where the user says nothing else."""
    said_nothing = options.fps is None and options.timestamps is None and options.times is TimeSource.AUTO
    calibrated = bool(options.calibration) or layout.calibration is None
    return replace(
        options,
        synchronized=options.synchronized or layout.same_frames,
        timestamps=layout.timestamps if said_nothing else options.timestamps,
        calibration=options.calibration if calibrated else (str(layout.calibration),),
        unit=options.unit if calibrated or options.unit else layout.unit,
    )


def _chosen(timeline: Timeline, options: ImportOptions) -> Sequence[Instant]:
    total = len(timeline.instants)
    if options.start < 0 or options.every < 1 or (options.count is not None and options.count < 1):
        raise BadInputError("--start counts from 0, --count and --every from 1")
    chosen = timeline.instants[options.start :: options.every][: options.count]
    if not chosen:
        raise BadInputError(f"the recording has {count(total, 'instant')}, none from {options.start} on")
    return chosen


def _write_images(
    writer: SessionWriter,
    sources: Sequence[Source],
    instants: Sequence[Instant],
    options: ImportOptions,
    progress: Progress,
) -> dict[str, tuple[int, int]]:
    """Save the frames of all instants; width and height in pixels by camera."""
    ms = options.uncertainty_ms
    uncertainty_ns = None if ms is None else round(ms * 1e6)
    total, done = sum(len(instant.frames) for instant in instants), 0
    sizes: dict[str, tuple[int, int]] = {}
    for source in sources:
        wanted: dict[int, tuple[int, TimedFrame]] = {
            instant.frames[source.name].index: (number, instant.frames[source.name])
            for number, instant in enumerate(instants)
            if source.name in instant.frames
        }
        for index, data, size in source.frames(sorted(wanted)):
            if sizes.setdefault(source.name, size) != size:
                raise BadInputError(f"{source.path} has images of {sizes[source.name]} and of {size} pixels")
            number, frame = wanted[index]
            writer.add_image(
                data,
                camera=source.name,
                instant=number,
                suffix=source.suffix,
                leader_ns=frame.leader_ns,
                local_ns=frame.local_ns,
                residual_ns=frame.leader_ns - instants[number].leader_ns,
                uncertainty_ns=uncertainty_ns,
                sequence=index,
            )
            done += 1
            progress(done, total)
        if source.name not in sizes:
            raise BadInputError(f"{source.path} has no frame at any of the {len(instants)} instants")
    return sizes


def _missing(writer: SessionWriter, names: Sequence[str], instants: Sequence[Instant]) -> list[MissingImage]:
    missing = []
    for number, instant in enumerate(instants):
        for name in names:
            if writer.image(name, number):
                continue
            unreadable = "the frame could not be decoded" if name in instant.frames else _NO_FRAME
            reason = instant.why_missing.get(name, unreadable)
            missing.append(MissingImage(camera=name, instant=number, reason=reason))
    return missing
