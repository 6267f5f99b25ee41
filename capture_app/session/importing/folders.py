"""What a path holds: a program's recordings, the takes in an arbitrary folder, or cameras that are named."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.text import Talk, count
from capture_app.session.importing.aligning import heard_together
from capture_app.session.importing.clips import find_calibration, find_shoots
from capture_app.session.importing.folder_tree import describe_unused
from capture_app.session.importing.import_options import ImportOptions
from capture_app.session.importing.importer import (
    camera_importer,
    open_sources,
    recognize_recording,
    recordings_in,
    split_name,
)
from capture_app.session.importing.recording_sources import VIDEO_SUFFIXES, Layout
from capture_app.session.importing.times.tables import find_tables

Found = tuple[str, Layout]
"""A recording with its name, which is empty if there is only this one."""


def find_recordings(paths: Sequence[str], options: ImportOptions, talk: Talk) -> list[Found]:
    """Return the recordings of a program's folder, or the takes in an arbitrary one; report what was found.

    Raises BadInputError if there is nothing to import.
    """
    given, folder = split_name(paths[0])
    only = options.recording
    if len(paths) > 1 or given or not folder.is_dir():
        return [("", open_recording(paths, options, talk))]
    recordings = [recording for recording in recordings_in(folder) if only in (None, recording)]
    if len(recordings) > 1:
        talk(f"{folder} has {count(len(recordings), 'recording')}, a session each: {', '.join(recordings)}")
        return [
            (recording, open_recording(paths, replace(options, recording=recording), talk))
            for recording in recordings
        ]
    if any(
        path.is_dir() and camera_importer(path) for path in (folder, *folder.iterdir())
    ) or recognize_recording(folder, recording=only):
        return [("", open_recording(paths, options, talk))]
    return _find_takes(folder, options, talk)


def _find_takes(folder: Path, options: ImportOptions, talk: Talk) -> list[Found]:
    shoots, left_out = find_shoots(folder, talk, heard_together)
    for take, clips in shoots:
        files = (f"{camera} = {clip.path.relative_to(folder)}" for camera, clip in clips.items())
        talk(f"found {take or 'one recording'}: {', '.join(files)}")
    for line in left_out:
        talk(f"left out {line}")
    takes = [
        (take, [f"{camera}={clip.path}" for camera, clip in clips.items()])
        for take, clips in shoots
        if options.recording in (None, take)
    ]
    beside = find_calibration(folder)
    found = [
        (take, replace(open_recording(cameras, options, talk), beside=beside))
        for take, cameras in takes or [("", [str(folder)])]
    ]
    if not options.states_times:
        found = [(take, _with_tables(layout, folder, talk)) for take, layout in found]
    used = [path for _, layout in found for path in _used(layout)]
    # What becomes of each video was said above.
    if said := describe_unused(folder, used, VIDEO_SUFFIXES if shoots else ()):
        talk(said)
    return found


def _used(layout: Layout) -> list[Path]:
    """Return the files and folders that a recording is read from."""
    tables = (path for _, path in layout.timestamps)
    calibrations = filter(None, (layout.calibration, layout.beside))
    return [*(source.path for source in layout.sources), *tables, *calibrations]


def _with_tables(layout: Layout, folder: Path, talk: Talk) -> Layout:
    found = find_tables(layout.sources, folder)
    for note in found.notes:
        talk(note)
    return replace(layout, timestamps=found.tables)


def open_recording(paths: Sequence[str], options: ImportOptions, talk: Talk) -> Layout:
    """Open `NAME=PATH` cameras or one folder; report whose it is. Raises as `open_sources`."""
    name, path = split_name(paths[0])
    layout = None
    if len(paths) == 1 and not name:
        layout = recognize_recording(path, png=options.png, recording=options.recording)
    if layout is None or (layout.record is not None and options.states_times):
        sources = open_sources(paths, png=options.png, recording=options.recording)
        return Layout(path=path, sources=tuple(sources))
    talk(f"{layout.path} is of {layout.program}")
    if layout.note:
        talk(layout.note)
    if layout.record is not None and options.offsets_ms:
        raise BadInputError(
            f"{path} has the times of its session, which --time-shift-ms would contradict",
            hint="import it without, and give reconstruct --time-shift-ms",
        )
    return layout
