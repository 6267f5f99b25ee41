"""Tables of times that lie beside a recording: found, tried, and taken only if one clock gave them."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.session.format.camera_labels import pair_labels
from capture_app.session.importing.frame_matching import Timeline, require_overlap
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


@dataclass(frozen=True, slots=True)
class FoundTables:
    """The tables to take, and what to say of all that were found."""

    tables: Sequence[Table]
    notes: Sequence[str]


def find_tables(sources: Sequence[Source], root: Path) -> FoundTables:
    """Return the tables of times in the sources' folders, or in folders above up to `root`, if they fit.

    One table with a column of cameras is taken. Tables of one camera each are taken if their times are dates
    that overlap. Otherwise each may count from its own start, which only the user can know.
    """
    notes: list[str] = []
    common: list[Path] = []
    own: list[Path] = []
    for path in _files_near(sources, root):
        try:
            columns, _ = read_columns(path)
        except BadInputError:
            continue
        if TIME_COLUMNS.keys() & columns.keys():
            (common if columns.keys() & set(CAMERA_COLUMNS) else own).append(path)
    for tables in (*([("", path)] for path in common), _of_cameras(own, sources)):
        if tables and (taken := _try(sources, tables, notes)):
            return FoundTables(taken, notes)
    return FoundTables((), notes)


def name_tables(tables: Sequence[Table], sources: Sequence[Source]) -> list[Table]:
    """Return tables that are given without a camera's name with the one that their files' names have."""
    if len(tables) < 2 or any(name for name, _ in tables):
        return list(tables)
    return _of_cameras([path for _, path in tables], sources) or list(tables)


def _try(sources: Sequence[Source], tables: Sequence[Table], notes: list[str]) -> Sequence[Table]:
    """Return the tables if they fit the recording and one clock gave them; note what was found."""
    names = ", ".join(path.name for _, path in tables)
    try:
        timeline, _ = timeline_by_tables(sources, tables)
        require_overlap(timeline)
    except BadInputError as error:
        notes.append(f"times: {names}: not taken: {error}")
        return ()
    cameras = timeline.cameras()
    counts = {f"{len(cameras[one.name])} of {len(one.numbers)} frames": one.name for one in sources}
    fits = "; ".join(counts if len(counts) == 1 else (f"{name}: {text}" for text, name in counts.items()))
    if why := _why_not_common(timeline, tables):
        given = " ".join(
            f"--timestamps {quote(f'{name}={path}' if name else str(path))}" for name, path in tables
        )
        notes.append(f"times: {names}: {fits}, not taken: {why}; if one clock gave them: {given}")
        return ()
    notes.append(f"times: {names}, {fits}")
    return tables


def _why_not_common(timeline: Timeline, tables: Sequence[Table]) -> str:
    """Return why the times may be of several clocks; empty if the tables tell that they are of one."""
    firsts_ns = [min(frame.leader_ns for frame in frames) for frames in timeline.cameras().values()]
    if len(firsts_ns) < 2:
        return ""
    if not any(firsts_ns):
        return "each camera counts from 0 in it"
    if len(tables) > 1 and min(firsts_ns) < _SINCE_1970_NS:
        return "each may count from its camera's own start"
    return ""


def _files_near(sources: Sequence[Source], root: Path) -> Iterator[Path]:
    """Yield the table files in the folders of the sources and above, up to `root`; the nearest first."""
    top = root.resolve()
    depths: dict[Path, int] = {}
    for source in sources:
        folder = source.path.resolve()
        for depth, above in enumerate((folder, *folder.parents)):
            if above.is_dir():
                depths[above] = min(depth, depths.get(above, depth))
            if above == top or top not in above.parents:
                break
    for folder in sorted(depths, key=lambda one: (depths[one], natural_order(str(one)))):
        yield from sorted(
            path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file()
        )


def _of_cameras(paths: Sequence[Path], sources: Sequence[Source]) -> list[Table]:
    """Return one table for each camera, by its file's name or its folder; none if a camera has none."""
    names = [source.name for source in sources]
    stems = {_OF_TIMES.sub("", path.stem) or path.parent.name: path for path in paths}
    by_stem = pair_labels(stems, [Path(source.path.name).stem for source in sources])
    named = {
        source.name: stems[by_stem[stem]]
        for source in sources
        if (stem := Path(source.path.name).stem) in by_stem
    }
    if len(named) < len(names):
        labels = pair_labels(stems, names)
        named = {name: stems[label] for name, label in labels.items()}
    if len(named) < len(names):
        named = dict(_alone_in_folder(paths, sources))
    return [(name, named[name]) for name in names] if len(named) == len(names) else []


def _alone_in_folder(paths: Sequence[Path], sources: Sequence[Source]) -> Mapping[str, Path]:
    """Return the table of each camera that lies alone in its camera's folder."""
    found: dict[str, Path] = {}
    for source in sources:
        folder = source.path.resolve()
        for place in (folder, folder.parent):
            shared = any(one is not source and place in one.path.resolve().parents for one in sources)
            inside = [path for path in paths if path.parent == place]
            if len(inside) == 1 and not shared:
                found[source.name] = inside[0]
                break
    return found
