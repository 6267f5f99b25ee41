"""What a path holds: a program's recordings, the takes in an arbitrary folder, or cameras that are named."""

import filecmp
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import VIDEO_SUFFIXES, label_key, natural_order
from capture_app.common.text import count
from capture_app.companions.importing.clips import find_shoots
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.times.tables import find_tables
from capture_app.session.importing.importer import (
    CALIBRATION,
    MAX_NAMED,
    CameraFiles,
    camera_importer,
    load_importers,
    open_cameras,
    open_sources,
    recognize_recording,
    recordings_in,
    split_name,
    takes_in,
)
from capture_app.session.importing.recording_sources import (
    Images,
    Layout,
    Source,
    folders_below,
)

_CALIBRATE = "write it as OpenCV's stereo.yml (M1 D1 M2 D2 R T), or calibrate the session"
UNREAD = (
    # https://github.com/zju3dv/neuralbody/blob/master/INSTALL.md
    ("annots.npy", "of ZJU-MoCap (cams)"),
)
"""Names of calibrations that no importer reads, and whose they are by their pages."""


def find_recordings(paths: Sequence[str], options: ImportOptions) -> tuple[list[Layout], list[str]]:
    """Return the recordings of a program's folder, or the takes in an arbitrary one, and lines about them.

    Where the user states the times, no table of them is looked for. Raises BadInputError if there is nothing
    to import.
    """
    given, path = split_name(paths[0])
    alone = len(paths) == 1 and not given
    named = recordings_in(path) if alone and path.is_dir() else []
    if named and options.recording not in (None, *named):
        raise BadInputError(f"{path} has no recording {options.recording}", hint=f"it has {', '.join(named)}")
    if named and options.recording is None:
        each = [replace(options, recording=recording) for recording in named]
        found = [find_recordings(paths, one)[0][0] for one in each]
        takes = [replace(layout, take=take) for layout, take in zip(found, named, strict=True)]
        said = f"{path} has {count(len(named), 'recording')}, a session each: {', '.join(named)}"
        return takes, [said] * (len(named) > 1)
    layout = recognize_recording(path, png=options.png, recording=options.recording) if alone else None
    if layout is not None and (layout.record is None or not options.states_times):
        return [replace(layout, notes=(f"{layout.path} is of {layout.program}", *layout.notes))], []
    arbitrary = layout is None and alone and path.is_dir()
    if arbitrary and not any(one.is_dir() and camera_importer(one) for one in (path, *path.iterdir())):
        return _find_takes(path, options)
    sources = open_sources(paths, png=options.png, recording=options.recording)
    return [Layout(path=path, sources=tuple(sources))], []


def _find_takes(folder: Path, options: ImportOptions) -> tuple[list[Layout], list[str]]:
    """Return the takes in an arbitrary folder, otherwise its cameras; and lines about them."""
    shoots, notes = find_shoots(folder)
    for take, clips in shoots:
        files = (f"{camera} = {clip.path.relative_to(folder)}" for camera, clip in clips.items())
        notes.append(f"found {take or 'one recording'}: {', '.join(files)}")
    named: dict[str, list[CameraFiles]] = {
        take: [(camera, clip.path, []) for camera, clip in of.items()] for take, of in shoots
    }
    if not shoots:
        named, said = takes_in(folder)
        notes += said
    opened = {
        take: open_cameras(cameras, png=options.png)
        for take, cameras in named.items()
        if options.recording is None or label_key(options.recording) == label_key(take)
    }
    if not opened:
        raise BadInputError(f"{folder} has no take {options.recording}", hint=f"it has {', '.join(named)}")
    beside, used = find_calibration(folder)
    found = []
    for take, sources in opened.items():
        tables, said = ((), []) if options.states_times else find_tables(sources, folder)
        notes += said
        for source in sources:
            # Of a folder that cameras share, the rest is not theirs.
            used += source.files if isinstance(source, Images) and source.path == folder else [source.path]
        used += [table for _, table in tables]
        found.append(Layout(path=folder, sources=tuple(sources), take=take, timestamps=tables, beside=beside))
    # Each video's use was reported above.
    return found, [*notes, *describe_unused(folder, used, VIDEO_SUFFIXES if shoots else ())]


def find_calibration(folder: Path) -> tuple[Path | None, list[Path]]:
    """Return a calibration in a folder, or in a subfolder with a name for calibrations; and its files."""
    inner = [path for path in sorted(folder.iterdir()) if path.is_dir() and CALIBRATION.search(path.name)]
    for place, importer in product((folder, *inner), load_importers()):
        files = [file for pattern in importer.calibration_files for file in sorted(place.glob(pattern))]
        if files:
            if not importer.calibration_per_camera:
                return files[0], files[:1]
            # A folder of calibrations is read whole.
            return place, files if place == folder else [place]
    return None, []


def describe_unused(folder: Path, used: Collection[Path], suffixes: Sequence[str] = ()) -> list[str]:
    """Return a line about the files below a folder that are not used, nor in used folders; none if none.

    Files of the `suffixes` are not listed.
    """
    whole = {path.resolve() for path in used}
    names: list[str] = []
    unread: dict[str, str] = {}
    for place in folders_below(folder):
        if place.resolve() in whole:
            continue
        files = [
            path
            for path in sorted(place.iterdir(), key=lambda path: natural_order(path.name))
            if path.is_file()
            and not path.name.startswith(".")
            and path.suffix.lower() not in suffixes
            and path.resolve() not in whole
        ]
        inside = place.relative_to(folder)
        unread |= {say: str(inside / path.name) for path in files for name, say in UNREAD if path.match(name)}
        kinds = Counter(path.suffix.lower() or "no suffix" for path in files)
        alone = [str(inside / path.name) for path in files if kinds[path.suffix.lower() or "no suffix"] < 3]
        names += alone
        where = "" if place == folder else f"{inside}: "
        names += [f"{where}{n} {kind}" for kind, n in kinds.items() if n >= 3]
    more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    said = [f"not used: {', '.join(names[:MAX_NAMED])}{more}"] if names else []
    return said + [
        f"calibration: {name} is {say}, which is not read: {_CALIBRATE}" for say, name in unread.items()
    ]


def describe_equal(sources: Sequence[Source]) -> list[str]:
    """Return a line about each two cameras whose files are equal."""
    files = [source.path for source in sources if source.path.is_file()]
    return [
        f"{one} and {other} are equal files: they are one camera, not two"
        for one, other in combinations(files, 2)
        if filecmp.cmp(one, other, shallow=False)
    ]
