"""Import of other programs' recordings as sessions: frames are matched in time, their bytes unchanged.

An export of one of our sessions retains that session's records.
"""

from collections.abc import Sequence
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import check_name
from capture_app.common.text import Progress, Talk, count
from capture_app.session.files.output_folder import OutputFolder, replaces_nothing
from capture_app.session.importing.aligning import align_times
from capture_app.session.importing.calibrations import choose_calibration, choose_views
from capture_app.session.importing.folders import find_recordings, open_recording
from capture_app.session.importing.frame_matching import Instant, Timeline
from capture_app.session.importing.import_options import ImportOptions
from capture_app.session.importing.recording_sources import Layout
from capture_app.session.importing.times.rules import make_times
from capture_app.session.importing.written import (
    burst_record,
    camera_records,
    first_sizes,
    missing_images,
    origin_of,
    write_images,
)
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter


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
    check_name(name, "session")
    found = find_recordings(paths, options, talk)
    several = len(found) > 1
    return [
        write_recording(layout, root, f"{name}-{take}" if several and take else name, options, progress, talk)
        for take, layout in found
    ]


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
    return write_recording(open_recording(paths, options, talk), root, name, options, progress, talk)


def write_recording(
    layout: Layout, root: Path, name: str, options: ImportOptions, progress: Progress, talk: Talk
) -> Session:
    """Write the session root/name from a recording: its times, views, alignment and images.

    Raises BadInputError for unusable input; then no session remains.
    """
    times = make_times(layout, options, talk)
    aligned = align_times(layout.sources, times, options, talk)
    instants = _chosen(aligned.timeline, options)
    sources, names = aligned.sources, [source.name for source in aligned.sources]
    views = choose_views(layout, options, names)
    # Times other than its own would contradict the rest of an exported session's record.
    own = layout.record is not None and times.timeline is layout.timeline
    taken = layout.record.manifest if layout.record and own else None
    with (
        OutputFolder(root / name, replaces_nothing) as output,
        SessionWriter(output.folder, name, taken.created if taken else "") as writer,
    ):
        calibration = choose_calibration(layout, views, lambda: first_sizes(sources, instants), options, talk)
        sizes = write_images(
            writer, sources, instants, options.uncertainty_ms, progress, own_times=aligned.own_times
        )
        if calibration is not None:
            writer.set_calibration(calibration)
        writer.finish(
            camera_records(sources, sizes, aligned.timeline, taken),
            burst_record(instants, aligned.timeline, aligned.common, taken),
            missing_images(writer, names, instants, taken),
            origin_of(writer, instants, taken),
            options.note or (taken.note if taken else ""),
        )
    return Session.open(root / name)


def _chosen(timeline: Timeline, options: ImportOptions) -> Sequence[Instant]:
    chosen = timeline.instants[options.start :: options.every][: options.count]
    if not chosen:
        raise BadInputError(
            f"the recording has {count(len(timeline.instants), 'instant')}, none from {options.start} on",
            hint="give a smaller --start",
        )
    return chosen
