"""Import of other programs' recordings as sessions: frames are matched in time, their bytes unchanged.

An export of one of our sessions retains that session's records.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path

from msgspec import structs

from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.common.errors import BadInputError
from capture_app.common.names import check_label, folder_names, label_of
from capture_app.common.text import Progress, Talk, count
from capture_app.companions.importing.aligning import align_times, split_views
from capture_app.companions.importing.found import describe_equal, find_recordings
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.times.rules import make_times
from capture_app.session.files.output_folder import OutputFolder, replaces_nothing
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.format.manifest import BurstRecord, CameraRecord, Manifest
from capture_app.session.importing.calibrations import choose_calibration
from capture_app.session.importing.frame_matching import Instant, Timeline
from capture_app.session.importing.realigning import missing_images
from capture_app.session.importing.recording_sources import Layout, Source, holds_two_views, labels_of
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter

IMPORTED = "imported"
SYNCED_TOGETHER = 64
"""Number of images that are made safe by one sync: the source still has them."""
_replaces_nothing = partial(replaces_nothing, option="--name")


def import_found(
    paths: Sequence[str],
    root: Path,
    name: str,
    options: ImportOptions,
    progress: Progress = lambda done, total: None,
    talk: Talk = lambda said: None,
) -> list[Session]:
    """Write `NAME=PATH` cameras or a folder as sessions in `root`: one for each recording or take in it.

    `name` may be any label: the sessions' folders have the nearest names. Raises BadInputError for unusable
    input; then no session remains of it.
    """
    name = check_label(name, "session")
    found, notes = find_recordings(paths, options)
    _say(notes, talk)
    labels = [label_of(f"{name}-{one.take}" if one.take and len(found) > 1 else name) for one in found]
    folders = folder_names(labels, "session", "recording")
    for folder in folders:
        OutputFolder(root / folder, _replaces_nothing)  # refuses one that exists before it takes long
    return [
        _import(one, root / folder, label, options, progress, talk)
        for one, folder, label in zip(found, folders, labels, strict=True)
    ]


def _import(
    found: Layout, folder: Path, label: str, options: ImportOptions, progress: Progress, talk: Talk
) -> Session:
    """Write a session from what was found: its times, their alignment, its calibration and its images."""
    of_sources = (note for source in found.sources for note in source.notes)
    _say((*found.notes, *of_sources, *describe_equal(found.sources)), talk)
    times = make_times(found, options)
    _say(times.notes, talk)
    aligned = align_times(found.sources, times, options)
    _say(aligned.notes, talk)
    if options.split:
        aligned = split_views(aligned)
    elif len(found.sources) == 1 and holds_two_views(found.sources[0]):
        talk("each picture may hold two views of one instant: if so, import again with --split side-by-side")
    instants, sources = _chosen(aligned.timeline, options), aligned.sources
    names = labels_of(sources)
    calibration, notes = choose_calibration(
        found, names, lambda: _sizes(sources, instants), options.calibration, options.unit, options.fit
    )
    _say(notes, talk)
    # Times other than its own would contradict the rest of an exported session's record.
    own = found.record is not None and times.timeline is found.timeline
    taken = found.record.manifest if found.record and own else None
    with (
        OutputFolder(folder, _replaces_nothing) as output,
        SessionWriter(output.folder, folder.name, taken.created if taken else "") as writer,
    ):
        own_times = aligned.common is not None and aligned.common.unknown
        sizes = _write_images(
            writer, sources, instants, options.uncertainty_ms, progress, own_times=own_times
        )
        if calibration is not None:
            writer.set_calibration(calibration)
        writer.finish(
            _camera_records(sources, sizes, aligned.timeline, taken),
            _burst_record(instants, aligned.timeline, aligned.common, taken),
            missing_images(writer, [*names], instants, taken),
            _origin_of(writer, instants, taken),
            options.note or (taken.note if taken else ""),
            label=label if label != folder.name else "",
        )
    return Session.open(folder)


def _say(notes: Iterable[str], talk: Talk) -> None:
    for note in notes:
        talk(note)


def _chosen(timeline: Timeline, options: ImportOptions) -> Sequence[Instant]:
    chosen = timeline.instants[options.start :: options.every][: options.count]
    if not chosen:
        raise BadInputError(
            f"the recording has {count(len(timeline.instants), 'instant')}, none from {options.start} on",
            hint="give a smaller --start",
        )
    return chosen


def _camera_records(
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
                label=source.label if source.label != source.name else "",
            ),
            source_frames=len(source.numbers),
        )
        for source in sources
    ]


def _burst_record(
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


def _origin_of(writer: SessionWriter, instants: Sequence[Instant], exported: Manifest | None) -> str:
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


def _numbers_of(source: Source, instants: Sequence[Instant]) -> dict[int, list[int]]:
    """Return the numbers of the instants that have a camera's frame, by the frame's index, ascending."""
    used = [(one.frames[source.name].index, n) for n, one in enumerate(instants) if source.name in one.frames]
    return {index: [n for _, n in of] for index, of in groupby(sorted(used), key=itemgetter(0))}


def _sizes(sources: Sequence[Source], instants: Sequence[Instant]) -> dict[str, tuple[int, int]]:
    """Return width and height in px of each camera's first frame of these instants that can be decoded."""
    firsts = {source.name: next(source.frames([*_numbers_of(source, instants)]), None) for source in sources}
    return {name: first[2] for name, first in firsts.items() if first is not None}


def _write_images(
    writer: SessionWriter,
    sources: Sequence[Source],
    instants: Sequence[Instant],
    uncertainty_ms: float | None,
    progress: Progress,
    *,
    own_times: bool,
) -> dict[str, tuple[int, int]]:
    """Save the frames of all instants; return width and height in px by camera.

    `uncertainty_ms` is the user's. `own_times`: the frames' times are each camera's own.
    """
    said = {} if uncertainty_ms is None else {"uncertainty_ns": round(uncertainty_ms * 1e6)}
    total, done = sum(len(instant.frames) for instant in instants), 0
    sizes: dict[str, tuple[int, int]] = {}
    for source in sources:
        numbers = _numbers_of(source, instants)
        for index, data, size in source.frames([*numbers]):
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
                    synced=False,
                    **{"local_ns": local_ns, "sequence": index, **frame.further, **said},
                )
            done += 1
            progress(done, total)
            if done % SYNCED_TOGETHER == 0:
                writer.sync()
        if source.name not in sizes:
            raise BadInputError(
                f"{source.path} has no frame at any of the {len(instants)} instants",
                hint="leave this camera out, or correct its times, as with --time-shift-ms",
            )
    writer.sync()
    return sizes
