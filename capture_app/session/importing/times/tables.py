"""Tables of times that lie beside a recording: found, tried, and taken only if one clock gave them."""

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from shlex import quote

from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.common.text import Talk
from capture_app.session.format.camera_labels import pair_labels
from capture_app.session.importing.frame_matching import require_overlap
from capture_app.session.importing.recording_sources import Source
from capture_app.session.importing.times.rate_or_table import (
    CAMERA_COLUMNS,
    TIME_COLUMNS,
    Table,
    read_columns,
    timeline_by_tables,
)

_SUFFIXES = (".csv", ".tsv")
_OF_TIMES = re.compile(
    r"[._\- ]*(frame|video)?[._\- ]*(times?|time_?stamps?|ts|metadata|data)$", re.IGNORECASE
)
"""What a table's name says besides its camera's."""
_SINCE_1970_NS = 946_684_800_000_000_000
"""Later times, from the year 2000 on, are dates; earlier ones count from some start."""


def find_tables(sources: Sequence[Source], root: Path, talk: Talk) -> Sequence[Table]:
    """Return the tables of times in the sources' folders, or in folders above up to `root`, if they fit.

    One table with a column of cameras is taken. Tables of one camera each are taken if their times are dates
    that overlap. Otherwise each may count from its own start, which only the user can know. `talk` receives
    what was found.
    """
    columns: dict[Path, Collection[str]] = {}
    for path in _files_near(sources, root):
        with suppress(BadInputError):
            columns[path] = read_columns(path)[0].keys()
    timed = [path for path, names in columns.items() if not TIME_COLUMNS.keys().isdisjoint(names)]
    own = [path for path in timed if set(CAMERA_COLUMNS).isdisjoint(columns[path])]
    tried = (*([("", path)] for path in timed if path not in own), _of_cameras(own, sources))
    return next((tables for tables in tried if tables and _fit(sources, tables, talk)), ())


def name_tables(tables: Sequence[Table], sources: Sequence[Source]) -> list[Table]:
    """Return tables that are given without a camera's name with the one that their files' names have."""
    if len(tables) < 2 or any(name for name, _ in tables):
        return list(tables)
    return _of_cameras([path for _, path in tables], sources) or list(tables)


def _fit(sources: Sequence[Source], tables: Sequence[Table], talk: Talk) -> bool:
    """Return whether tables fit the recording, and one clock gave them; report it."""
    names = ", ".join(path.name for _, path in tables)
    try:
        timeline, _ = timeline_by_tables(sources, tables)
        require_overlap(timeline)
    except BadInputError as error:
        talk(f"times: {names}: not taken: {error}")
        return False
    cameras = timeline.cameras()
    counts = {f"{len(cameras[one.name])} of {len(one.numbers)} frames": one.name for one in sources}
    fits = "; ".join(counts if len(counts) == 1 else (f"{name}: {text}" for text, name in counts.items()))
    # Only tables can tell whether their times are of one clock.
    firsts_ns = [min(frame.leader_ns for frame in frames) for frames in cameras.values()]
    why = ""
    if len(firsts_ns) > 1 and not any(firsts_ns):
        why = "each camera counts from 0 in it"
    elif len(tables) > 1 and min(firsts_ns) < _SINCE_1970_NS:
        why = "each may count from its camera's own start"
    if why:
        given = " ".join(
            f"--timestamps {quote(f'{name}={path}' if name else str(path))}" for name, path in tables
        )
        fits += f", not taken: {why}; if one clock gave them: {given}"
    talk(f"times: {names}{': ' if why else ', '}{fits}")
    return not why


def _files_near(sources: Sequence[Source], root: Path) -> Iterator[Path]:
    """Yield the table files in the folders of the sources and above, up to `root`; the nearest first."""
    near = sorted(
        (depth, natural_order(str(above)), above)
        for source in sources
        for depth, above in enumerate(_with_parents(source.path))
        if root.resolve() in _with_parents(above) and above.is_dir()
    )
    for folder in dict.fromkeys(above for *_, above in near):
        yield from sorted(
            path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file()
        )


def _with_parents(path: Path) -> tuple[Path, ...]:
    return (path.resolve(), *path.resolve().parents)


def _of_cameras(paths: Sequence[Path], sources: Sequence[Source]) -> list[Table]:
    """Return one table for each camera, by its file's name or its folder; none if a camera has none."""
    names = [source.name for source in sources]
    stems = {_OF_TIMES.sub("", path.stem) or path.parent.name: path for path in paths}
    for own in ([Path(source.path.name).stem for source in sources], names):
        labels = pair_labels(stems, own)
        # Two videos of one name do not tell which table is whose.
        if len(labels) == len(sources):
            return [(name, stems[labels[label]]) for name, label in zip(names, own, strict=True)]
    # A table that lies alone in its camera's folder; in the deepest one, if there are several.
    folders = sorted({path.resolve().parent for path in paths}, key=lambda folder: len(folder.parts))
    inside = {folder: [path for path in paths if path.resolve().parent == folder] for folder in folders}
    of = {folder: [one.name for one in sources if folder in _with_parents(one.path)] for folder in folders}
    alone = {
        of[folder][0]: inside[folder][0] for folder in folders if len(inside[folder]) == len(of[folder]) == 1
    }
    return [(name, alone[name]) for name in names] if len(alone) == len(names) else []
