"""Import of other programs' recordings as sessions: frames are matched in time, their bytes unchanged.

An export of one of our sessions retains that session's records.
"""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from msgspec import structs

from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.common.errors import BadInputError
from capture_app.common.instants import is_same_instant
from capture_app.common.names import check_name
from capture_app.common.text import Progress, Talk, count
from capture_app.session.files.output_folder import OutputFolder, replaces_nothing
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.format.export_record import ExportRecord
from capture_app.session.format.manifest import BurstRecord, CameraRecord, Manifest, MissingImage
from capture_app.session.importing.aligning import align_recording, heard_together, with_common_times
from capture_app.session.importing.calibrations import fit_calibration, read_views
from capture_app.session.importing.clips import find_calibration, find_shoots
from capture_app.session.importing.frame_gaps import describe_gaps
from capture_app.session.importing.frame_matching import Instant, TimedFrame, Timeline, nearest
from capture_app.session.importing.import_options import (
    SOUND_M_PER_S,
    ImportOptions,
    clock_state,
    make_timeline,
)
from capture_app.session.importing.importer import (
    camera_importer,
    open_sources,
    recognize_recording,
    recordings_in,
    split_name,
)
from capture_app.session.importing.recording_sources import Layout, Source
from capture_app.session.importing.views import Views
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter

IMPORTED = "imported"
OTHER_RATE = 1.1
"""Minimum ratio of frame periods for which one camera is slower. Below it, one lost frames, or drifts."""
_NO_FRAME, _UNREADABLE = "the recording has no frame of it", "the frame could not be decoded"


def camera_records(
    sources: Sequence[Source],
    sizes: Mapping[str, tuple[int, int]],
    timeline: Timeline,
    exported: Manifest | None,
) -> list[CameraRecord]:
    """Return a manifest record of each source's camera.

    `exported` is the manifest of an exported session, whose own records are kept. `sizes` are widths and
    heights in px, by camera; `timeline` has the measured periods.
    """
    known = {
        camera.name: structs.replace(
            camera,
            facts=structs.replace(camera.facts, width=sizes[camera.name][0], height=sizes[camera.name][1]),
        )
        for camera in (exported.cameras if exported else ())
        if camera.name in sizes
    }
    return [
        known[source.name]
        if source.name in known
        else CameraRecord(
            name=source.name,
            facts=CameraFacts(
                kind=IMPORTED,
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


def burst_record(
    instants: Sequence[Instant], timeline: Timeline, common: CommonTimes | None, exported: Manifest | None
) -> BurstRecord:
    """Return the burst record of these instants; an exported session with all its instants keeps its own."""
    times_ns = tuple(instant.leader_ns for instant in instants)
    if exported is not None and exported.burst.instants_ns == times_ns:
        return exported.burst
    return BurstRecord(
        instants_ns=times_ns,
        period_ns=timeline.period_ns,
        common_times=exported.burst.common_times if exported else common,
    )


def missing_images(
    writer: SessionWriter, names: Sequence[str], instants: Sequence[Instant], exported: Manifest | None
) -> list[MissingImage]:
    """Return the images that the session lacks, with the reasons."""
    times_ns = exported.burst.instants_ns if exported else ()
    absent = exported.missing if exported else ()
    dropped = {(absence.camera, times_ns[absence.instant]) for absence in absent if absence.dropped}
    return [
        MissingImage(
            camera=name,
            instant=number,
            reason=instant.why_missing.get(name, _UNREADABLE if name in instant.frames else _NO_FRAME),
            dropped=(name, instant.leader_ns) in dropped,
        )
        for number, instant in enumerate(instants)
        for name in names
        if not writer.image(name, number)
    ]


def origin_of(writer: SessionWriter, instants: Sequence[Instant], exported: Manifest | None) -> str:
    """Return the origin of a session; an exported session with identical images keeps its origin."""
    if exported is None:
        return IMPORTED
    recorded = {
        (image.camera, exported.burst.instants_ns[image.instant]): image.sha256 for image in exported.images
    }
    saved = {
        (name, instant.leader_ns): writer.image(name, number)
        for number, instant in enumerate(instants)
        for name in instant.frames
    }
    same = all(image and image.sha256 == recorded.get(place) for place, image in saved.items())
    return exported.origin if same else IMPORTED


def import_recording(
    paths: Sequence[str],
    root: Path,
    name: str,
    options: ImportOptions,
    progress: Progress = lambda done, total: None,
    talk: Talk = lambda said: None,
) -> Session:
    """Write the session root/name from `NAME=PATH` cameras or one folder of them.

    Raises BadInputError for unusable input; then no session remains.
    """
    check_name(name, "session")
    layout = _layout(paths, options, talk)
    options = _with_layout(layout, options) if layout else options
    sources = layout.sources if layout else open_sources(paths, png=options.png, recording=options.recording)
    record = layout.record if layout else None
    common = clock_state(sources, options)
    timeline = make_timeline(sources, options)
    for note in filter(None, (source.note for source in sources)):
        talk(note)
    if record is None:
        for note in describe_gaps(sources, timeline):
            talk(note)
    if common is not None and common.unknown:
        common = align_recording(
            sources,
            timeline,
            common,
            options.align,
            sound_error_s=options.sound_distance_m / SOUND_M_PER_S + options.sound_delay_ms / 1000,
            rate_given=options.fps is not None,
            talk=talk,
        )
    if common is not None and common.cameras:
        sources = [source for source in sources if source.name in common.cameras]
        timeline = trim(with_common_times(timeline, common), talk)
    instants = _chosen(timeline, options)
    names = [source.name for source in sources]
    places = [split_name(text) for text in options.calibration]
    views = read_views(places, names) if places else layout.views if layout else None
    # Times other than its own would contradict the rest of an exported session's record.
    taken = record.manifest if layout and record and timeline is layout.timeline else None
    with (
        OutputFolder(root / name, replaces_nothing) as output,
        SessionWriter(output.folder, name, taken.created if taken else "") as writer,
    ):
        own_times = common is not None and common.unknown
        calibration = None
        if record or views is not None or options.beside is not None:
            calibration = _fitting(record, views, _first_sizes(sources, instants), options, talk)
        sizes = _write_images(writer, sources, instants, options, progress, own_times=own_times)
        if calibration is not None:
            writer.set_calibration(calibration)
        writer.finish(
            camera_records(sources, sizes, timeline, taken),
            burst_record(instants, timeline, common, taken),
            missing_images(writer, names, instants, taken),
            origin_of(writer, instants, taken),
            options.note or (taken.note if taken else ""),
        )
    return Session.open(root / name)


def _first_sizes(sources: Sequence[Source], instants: Sequence[Instant]) -> dict[str, tuple[int, int]]:
    """Return width and height in px of each camera's first frame of these instants that can be decoded."""
    sizes: dict[str, tuple[int, int]] = {}
    for source in sources:
        indices = sorted(
            {instant.frames[source.name].index for instant in instants if source.name in instant.frames}
        )
        for _, _, size in source.frames(indices):
            sizes[source.name] = size
            break
    return sizes


def _fitting(
    record: ExportRecord | None,
    views: Views | None,
    sizes: Mapping[str, tuple[int, int]],
    options: ImportOptions,
    talk: Talk,
) -> Calibration | None:
    """Return the calibration for images of these sizes: the given one, the export's, or the one beside."""
    if views is not None:
        return fit_calibration(views, sizes, unit=options.unit, fit=options.fit, talk=talk)
    if options.beside is None:
        return _calibration_of(record, sizes) if record else None
    try:
        beside = read_views([("", options.beside)], list(sizes))
        calibration = fit_calibration(beside, sizes, unit=options.unit, fit=options.fit, talk=talk)
    except BadInputError as error:
        talk(f"calibration: {options.beside} is not taken: {error}")
        return _calibration_of(record, sizes) if record else None
    talk(f"calibration: {options.beside}")
    return calibration


def trim(timeline: Timeline, talk: Talk) -> Timeline:
    """Return the part of a timeline in which all cameras run, at the rate of the slowest."""
    said: list[str] = []
    timeline = at_slowest_rate(overlap(timeline, said.append), said.append)
    if said:
        talk("; ".join(said))
    return timeline


def overlap(timeline: Timeline, talk: Talk) -> Timeline:
    """Return the part of a timeline in which all cameras run; the whole one if there is none."""
    cameras = timeline.cameras().values()
    begin_ns = max(frames[0].leader_ns for frames in cameras) - timeline.period_ns // 2
    end_ns = min(frames[-1].leader_ns for frames in cameras) + timeline.period_ns // 2
    shared = [instant for instant in timeline.instants if begin_ns <= instant.leader_ns <= end_ns]
    if not shared:
        return timeline
    if (rest := len(timeline.instants) - len(shared)) > 0:
        talk(
            f"all cameras run for {(end_ns - begin_ns) / 1e9:.1f} s; "
            f"{count(rest, 'instant')} beside are left out"
        )
    return replace(timeline, instants=shared)


def at_slowest_rate(timeline: Timeline, talk: Talk) -> Timeline:
    """Return a timeline whose instants are those of the slowest cameras, with the others' nearest frames.

    Where the slowest lack a frame, an instant of the others remains in its place.
    """
    periods = timeline.camera_periods_ns
    slowest_ns = max(periods.values())
    if slowest_ns < OTHER_RATE * min(periods.values()):
        return timeline
    slow = {name for name, period_ns in periods.items() if period_ns > slowest_ns / OTHER_RATE}
    slow_ns = [instant.leader_ns for instant in timeline.instants if not slow.isdisjoint(instant.frames)]
    kept: list[Instant] = []
    for one in timeline.instants:
        after = bisect_right(slow_ns, one.leader_ns)
        near_ns = [*(instant.leader_ns for instant in kept[-1:]), *slow_ns[after : after + 1]]
        is_alone = all(abs(one.leader_ns - at_ns) > 0.7 * slowest_ns for at_ns in near_ns)
        if is_alone or not slow.isdisjoint(one.frames):
            kept.append(one)
    # Of cameras that are little faster, a frame may have been nearest to an instant that is left out.
    others = {name: frames for name, frames in timeline.cameras().items() if name not in slow}
    paired = [_with_nearest(instant, others, slowest_ns) for instant in kept]
    fast = ", ".join(
        f"{name} {1e9 / period_ns:.4g}" for name, period_ns in periods.items() if name not in slow
    )
    talk(
        f"{fast} frames a second, {', '.join(sorted(slow))} {1e9 / slowest_ns:.4g}: the nearest are taken, "
        f"{count(len(timeline.instants) - len(kept), 'instant')} between are left out"
    )
    return replace(timeline, instants=paired, period_ns=slowest_ns)


def _with_nearest(instant: Instant, cameras: Mapping[str, Sequence[TimedFrame]], period_ns: int) -> Instant:
    """Return an instant with those cameras' nearest frames within half a period."""
    near = {
        name: frames[nearest([frame.leader_ns for frame in frames], instant.leader_ns)]
        for name, frames in cameras.items()
        if name not in instant.frames
    }
    frames = {
        name: frame
        for name, frame in (*instant.frames.items(), *near.items())
        if name in instant.frames or is_same_instant(frame.leader_ns - instant.leader_ns, period_ns)
    }
    return replace(
        instant,
        frames=frames,
        why_missing={name: why for name, why in instant.why_missing.items() if name not in frames},
    )


def import_found(
    paths: Sequence[str],
    root: Path,
    name: str,
    options: ImportOptions,
    progress: Progress = lambda done, total: None,
    talk: Talk = lambda said: None,
) -> list[Session]:
    """Write a session for each recording that is found; in an arbitrary folder, for each take.

    Raises as `import_recording` does.
    """
    given, folder = split_name(paths[0])
    only = options.recording
    if len(paths) > 1 or given or not folder.is_dir():
        return [import_recording(paths, root, name, options, progress, talk)]
    recordings = [recording for recording in recordings_in(folder) if only in (None, recording)]
    if len(recordings) > 1:
        talk(f"{folder} has {count(len(recordings), 'recording')}, a session each: {', '.join(recordings)}")
        chosen = [(paths, recording, replace(options, recording=recording)) for recording in recordings]
    elif any(
        path.is_dir() and camera_importer(path) for path in (folder, *folder.iterdir())
    ) or recognize_recording(folder, recording=only):
        chosen = [(paths, "", options)]
    else:
        shoots, left_out = find_shoots(folder, talk, heard_together)
        options = replace(options, beside=None if options.calibration else find_calibration(folder))
        for take, clips in shoots:
            files = (f"{camera} = {clip.path.relative_to(folder)}" for camera, clip in clips.items())
            talk(f"found {take or 'one recording'}: {', '.join(files)}")
        for line in left_out:
            talk(f"left out {line}")
        chosen = [
            ([f"{camera}={clip.path}" for camera, clip in clips.items()], take, options)
            for take, clips in shoots
            if only in (None, take)
        ] or [(paths, "", options)]
    return [
        import_recording(
            sources,
            root,
            f"{name}-{recording}" if recording and len(chosen) > 1 else name,
            of,
            progress,
            talk,
        )
        for sources, recording, of in chosen
    ]


def _layout(paths: Sequence[str], options: ImportOptions, talk: Talk) -> Layout | None:
    if len(paths) != 1:
        return None
    name, path = split_name(paths[0])
    layout = None if name else recognize_recording(path, png=options.png, recording=options.recording)
    if layout is None or (layout.record is not None and options.report_times):
        return None
    talk(f"{layout.path} is of {layout.program}")
    if layout.note:
        talk(layout.note)
    if layout.record is not None and options.offsets_ms:
        raise BadInputError(
            f"{path} has the times of its session, which --time-shift-ms would contradict",
            hint="import it without, and give reconstruct --time-shift-ms",
        )
    return layout


def _with_layout(layout: Layout, options: ImportOptions) -> ImportOptions:
    """Return the options, completed by what the folder states where the user gave nothing."""
    calibrated = bool(options.calibration) or layout.calibration is None
    return replace(
        options,
        synchronized=options.synchronized or layout.same_frames,
        known=layout.timeline,
        known_of=f"times of {layout.times_of}" if layout.times_of else "",
        timestamps=options.timestamps if options.report_times else layout.timestamps,
        calibration=options.calibration if calibrated else (str(layout.calibration),),
        unit=options.unit if calibrated or options.unit else layout.unit,
    )


def _calibration_of(record: ExportRecord, sizes: Mapping[str, tuple[int, int]]) -> Calibration | None:
    """Return the exported calibration. Raises BadInputError if the images now have a different size."""
    for name, camera in record.calibration.cameras.items() if record.calibration else ():
        if sizes.get(name, (camera.width, camera.height)) != (camera.width, camera.height):
            was, now = f"{camera.width}x{camera.height}", "x".join(map(str, sizes[name]))
            raise BadInputError(
                f"{name} was exported with {was} pixels and has {now} now",
                hint="give one that fits: --calibration PATH",
            )
    return record.calibration


def _chosen(timeline: Timeline, options: ImportOptions) -> Sequence[Instant]:
    chosen = timeline.instants[options.start :: options.every][: options.count]
    if not chosen:
        raise BadInputError(
            f"the recording has {count(len(timeline.instants), 'instant')}, none from {options.start} on",
            hint="give a smaller --start",
        )
    return chosen


def _write_images(
    writer: SessionWriter,
    sources: Sequence[Source],
    instants: Sequence[Instant],
    options: ImportOptions,
    progress: Progress,
    *,
    own_times: bool,
) -> dict[str, tuple[int, int]]:
    """Save the frames of all instants; return width and height in px by camera.

    `own_times`: the frames' times are each camera's own.
    """
    ms = options.uncertainty_ms
    said = {} if ms is None else {"uncertainty_ns": round(ms * 1e6)}
    total, done = sum(len(instant.frames) for instant in instants), 0
    sizes: dict[str, tuple[int, int]] = {}
    for source in sources:
        numbers: dict[int, list[int]] = {}
        for number, instant in enumerate(instants):
            if source.name in instant.frames:
                numbers.setdefault(instant.frames[source.name].index, []).append(number)
        for index, data, size in source.frames(sorted(numbers)):
            if sizes.setdefault(source.name, size) != size:
                raise BadInputError(
                    f"{source.path} has images of {sizes[source.name]} and of {size} pixels",
                    hint="import the images of each size as a camera of its own",
                )
            for number in numbers[index]:
                instant, frame = instants[number], instants[number].frames[source.name]
                local_ns = frame.leader_ns if own_times else frame.local_ns
                writer.add_image(
                    data,
                    camera=source.name,
                    instant=number,
                    suffix=source.suffix,
                    leader_ns=frame.leader_ns,
                    residual_ns=frame.leader_ns - instant.leader_ns,
                    **{"local_ns": local_ns, "sequence": index, **frame.further, **said},
                )
            done += 1
            progress(done, total)
        if source.name not in sizes:
            raise BadInputError(
                f"{source.path} has no frame at any of the {len(instants)} instants",
                hint="leave this camera out, or correct its times, as with --time-shift-ms",
            )
    return sizes
