"""Tables of times: found beside a recording or given, tried, and matched to its frames."""

import csv
import re
import statistics
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from pathlib import Path, PurePath

from capture_app.common.bounds import CENTURY_NS
from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.common.text import command_line
from capture_app.session.files.untrusted_files import read_text, rejecting
from capture_app.session.format.camera_labels import describe_pairs, pair_labels, require_camera
from capture_app.session.importing.frame_matching import (
    Instant,
    TimedFrame,
    Timeline,
    check_order,
    middle,
    periods_of,
    require_overlap,
    timeline_by_times,
)
from capture_app.session.importing.recording_sources import Images, Source, labels_of

Table = tuple[str, Path]
"""A table of times: the name of the camera that it is of, or '' if a column names the cameras; its file."""
CAMERA_COLUMNS = ("camera", "cam_id", "cam", "port", "camera_id")
_FRAME = ("frame", "frame_index", "frame_number", "frame_id")
_FILE = ("filename", "file", "image")
_GROUP = ("sync_index", "instant")
_TIMES = ("time", "frame_time", "timestamp", "timestamps")
_UNITS = {"": 9, "_s": 9, "_sec": 9, "_ms": 6, "_us": 3, "_ns": 0}
TIME_COLUMNS = {f"{word}{unit}": power for word in _TIMES for unit, power in _UNITS.items()}
"""Column names of a time, as `time_ms`, and the power of ten that converts their unit to ns."""
_HEADER = re.compile(r"#?\s*(?P<word>\w+?)(?:[_\s]*[\[(]?(?P<unit>s|sec|ms|us|ns)[\])]?)?\s*")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:")


@dataclass(frozen=True, slots=True)
class _Row:
    """A row of a table: its camera, and what its cells state; None for an empty cell or no such column."""

    camera: str
    frame: int | None
    group: str | None
    at_ns: int | None


_Timed = list[tuple[str | None, TimedFrame]]
"""The frames of a camera that have a time, each with its sync_index."""


def timeline_by_tables(sources: Sequence[Source], tables: Sequence[Table]) -> tuple[Timeline, list[str]]:
    """Match frames by tables of their times; return also what had to be assumed of them.

    One table has the column camera, or each is of one camera. Rows with the same sync_index are one instant;
    without a sync_index, frames less than half a period apart. Without frame numbers, or if these are no
    positions in the recording, the rows of a camera are its frames in order. An empty time is a dropped
    frame. Raises BadInputError, with the line, if a table contradicts itself or the recording.
    """
    rows, notes = _read_tables(tables, sources)
    where = " and ".join(str(path) for _, path in tables)
    counts = {source.name: len(source.numbers) for source in sources}
    rows = _positions(where, rows, counts, notes)
    timed = {name: _timed_frames(where, name, rows, count) for name, count in counts.items()}
    cameras = {name: [frame for _, frame in of] for name, of in timed.items()}
    if any(row.group is None for row in rows):
        return timeline_by_times(where, cameras), notes
    for name, frames in cameras.items():
        check_order(f"{where}: camera {name}", frames)
    instants = _by_group(where, rows, timed)
    for before, after in pairwise(instants):
        if after.leader_ns <= before.leader_ns:
            raise BadInputError(
                f"{where}: two instants are at the same time, {after.leader_ns} ns",
                hint="give each instant its own sync_index and time",
            )
    periods = periods_of(cameras)
    return Timeline(instants, round(statistics.median(periods.values())), periods), notes


def _read_tables(tables: Sequence[Table], sources: Sequence[Source]) -> tuple[list[_Row], list[str]]:
    """Return the rows of the sources' cameras, by these names, and which name of a table is whose."""
    by_name, called = {source.name: source for source in sources}, labels_of(sources)
    rows: list[_Row] = []
    notes: list[str] = []
    for name, path in tables:
        own = [by_name[require_camera(name, called, "--timestamps")]] if name else sources
        rows += _read_table(path, own, notes, per_camera=bool(name))
    timed = {row.camera for row in rows if row.at_ns is not None}
    if lacking := [name for name in by_name if name not in timed]:
        named = ", ".join(dict.fromkeys(row.camera for row in rows)) or "none"
        raise BadInputError(
            f"{' and '.join(str(path) for _, path in tables)} has no times of camera {lacking[0]}; "
            f"it names {named}",
            hint="add its rows; the column camera must have the names of the imported cameras",
        )
    return rows, notes


def _read_table(
    path: Path, sources: Sequence[Source], notes: list[str], *, per_camera: bool
) -> Iterator[_Row]:
    columns, lines = read_columns(path)
    camera, frame, file, group = (
        next((columns[name] for name in known if name in columns), None)
        for known in (CAMERA_COLUMNS, _FRAME, _FILE, _GROUP)
    )
    time = next((columns[name] for name in columns if name in TIME_COLUMNS), None)
    alone = per_camera or len(sources) == 1
    if time is None or (not alone and (camera is None or (frame is None and group is None))):
        raise BadInputError(
            f"{path} has the columns {', '.join(columns) or '(none)'}",
            hint=f"it needs {CAMERA_COLUMNS[0]}, {_FRAME[0]} or {_GROUP[0]}, and one of time (s), time_ms, "
            "time_us, time_ns; a table of one camera, given as NAME=CSV, needs only the time",
        )
    ns = 10 ** next(TIME_COLUMNS[name] for name in columns if columns[name] == time)
    names = {"": sources[0].name} if alone else {}
    if camera is not None and not alone:
        labels = list(dict.fromkeys((line[camera] or "").strip() for _, line in lines))
        cameras = labels_of(sources)
        pairs = pair_labels(labels, cameras)
        names = {label: name for name, label in pairs.items()}
        if said := describe_pairs(path.name, pairs, labels, cameras):
            notes.append(said)
    own = sources[0] if alone else None
    files = {image.name: n for n, image in enumerate(own.files)} if isinstance(own, Images) else {}
    # KITTI has a row more than pictures, whose names are the numbers of their rows, from 0.
    places = {counter: n for n, counter in enumerate(own.name_numbers)} if own and not (frame or file) else {}
    numbered = len(lines) > len(places) and (0,) in places
    for row, (where, line) in enumerate(lines):
        label = "" if alone or camera is None else (line[camera] or "").strip()
        if label not in names:
            continue
        number = _parse(where, line[frame], None) if frame else None
        image = PurePath((line[file] or "").strip()).name if file else ""
        # A table may list images that were not copied.
        if files and image and (number := files.get(image)) is None:
            continue
        if numbered and (number := places.get((row,))) is None:
            continue
        at_ns = _parse(where, line[time], ns)
        yield _Row(names[label], number, (line[group] or "").strip() if group else None, at_ns)


def read_columns(path: Path) -> tuple[dict[str, str], list[tuple[str, dict[str, str]]]]:
    """Return a table's columns, by their names in lower case with the unit, and its lines with their place.

    Raises BadInputError if it cannot be read.
    """
    text = read_text(path)
    first = text.partition("\n")[0]
    delimiter = next((mark for mark in ",;\t" if mark in first), ",")
    # Bonsai and KITTI write dates, KITTI's odometry seconds, without a header.
    bare = _DATE.match(first) or re.fullmatch(r"\d+\.\d+(e[+-]\d+)?\s*", first)
    fields = [f"time{n or ''}" for n in range(first.count(delimiter) + 1)] if bare else None
    reader = csv.DictReader(text.splitlines(), fields, delimiter=delimiter, skipinitialspace=True)
    with rejecting(f"cannot read the table {path}", csv.Error, hint="save it as comma-separated values"):
        columns = {_column(str(name)): str(name) for name in reader.fieldnames or ()}
        return columns, [(f"{path}, line {reader.line_num}", line) for line in reader]


def _column(name: str) -> str:
    """Return a column's name as `_TIMES` and the others have it: lower case, `time_ns` for `#Time [ns]`."""
    plain = name.strip().lower()
    match = _HEADER.fullmatch(plain)
    return "_".join(filter(None, match.groups())) if match and match["word"] in _TIMES else plain


def _positions(where: str, rows: list[_Row], counts: Mapping[str, int], notes: list[str]) -> list[_Row]:
    """Return rows whose frame numbers are positions; numbers that are not count the rows' order only.

    A recorder may count since its cameras' start. Then no number of this table is a position, and a camera
    needs a row for each frame.
    """
    timed = [(row.camera, row.frame) for row in rows if row.at_ns is not None and row.frame is not None]
    wrong = [(name, number) for name, number in timed if not 0 <= number < counts[name]]
    numbers = {name: sorted(number for own, number in timed if own == name) for name in counts}
    if not wrong:
        return rows
    if any(len(of) != counts[name] or len(set(of)) < len(of) for name, of in numbers.items()):
        name, number = wrong[0]
        raise BadInputError(
            f"{where} names frame {number} of camera {name}, which has {counts[name]} frames",
            hint="correct the column frame, which counts from 0",
        )
    ranges = ", ".join(f"{name} {of[0]} to {of[-1]}" for name, of in numbers.items())
    notes.append(
        f"{where}: its frame numbers are no positions in the files ({ranges}): its rows are taken in order"
    )
    places = {(name, number): n for name, of in numbers.items() for n, number in enumerate(of)}
    return [
        row if row.frame is None else replace(row, frame=places.get((row.camera, row.frame))) for row in rows
    ]


def _parse(where: str, text: str | None, ns: int | None) -> int | None:
    """Parse a cell: a time in units of `ns`, or a frame number if `ns` is None; None for an empty cell."""
    cell = (text or "").strip()
    if not cell:
        return None
    with suppress(ArithmeticError, ValueError):
        if ns is not None and _DATE.match(cell):
            return _date_ns(cell)
        number = Decimal(int(cell)) if ns is None else Decimal(cell) * ns
        if abs(number) <= CENTURY_NS:
            return round(number)
    raise BadInputError(
        f"{where}: {text!r} is not {'a time' if ns else 'a frame number'}",
        hint=f"write a number such as {'12.5' if ns else '12'}; leave the cell of a dropped frame empty",
    )


def _date_ns(cell: str) -> int:
    """Return an ISO 8601 date in ns since 1970, UTC unless it states a zone. Raises ValueError."""
    moment = datetime.fromisoformat(cell)
    whole = moment.replace(tzinfo=moment.tzinfo or UTC, microsecond=0)
    fraction = re.search(r":\d\d[.,](\d+)", cell)
    return round(whole.timestamp()) * 1_000_000_000 + int(
        (fraction[1] if fraction else "0")[:9].ljust(9, "0")
    )


def _timed_frames(where: str, name: str, rows: Sequence[_Row], count: int) -> _Timed:
    """Return the frames of a camera that have a time; without frame numbers they are in the times' order."""
    own = [row for row in rows if row.camera == name and row.at_ns is not None]
    numbers = [row.frame for row in own if row.frame is not None]
    if len(numbers) < len(own):
        if len(own) != count:
            raise BadInputError(
                f"{where} has {len(own)} times of camera {name}, which has {count} frames",
                hint="add the column frame: the number of each frame, from 0",
            )
        own.sort(key=lambda row: row.at_ns or 0)
        numbers = list(range(count))
    if len(set(numbers)) < len(numbers):
        raise BadInputError(
            f"{where} names a frame of camera {name} twice", hint="remove one of the two rows"
        )
    if (times := len({row.at_ns for row in own})) < max(2, len(own)):
        raise BadInputError(
            f"{where}: camera {name} has {'only one time' if times == 1 == len(own) else 'a time twice'}",
            hint="each camera needs two different times or more",
        )
    timed = ((row.group, TimedFrame(n, row.at_ns or 0)) for n, row in zip(numbers, own, strict=True))
    return sorted(timed, key=lambda one: one[1].index)


def _by_group(where: str, rows: Sequence[_Row], timed: Mapping[str, _Timed]) -> list[Instant]:
    groups: dict[str | None, dict[str, TimedFrame]] = {}
    for name, of in timed.items():
        for group, frame in of:
            if groups.setdefault(group, {}).setdefault(name, frame) is not frame:
                raise BadInputError(
                    f"{where} has instant {group} of camera {name} twice", hint="remove one of the two rows"
                )
    dropped = {(row.group, row.camera) for row in rows if row.at_ns is None}
    reason = "dropped by the camera: the table gives no time"
    instants = (
        Instant(middle(frames), frames, {name: reason for name in timed if (group, name) in dropped})
        for group, frames in groups.items()
    )
    return sorted(instants, key=lambda instant: instant.leader_ns)


_SUFFIXES = (".csv", ".tsv", ".txt")
COMMON_TIMES = "times.txt"
_OF_TIMES = re.compile(
    r"([._\- ]*(frame|video)?[._\- ]*(times?|time_?stamps?)|(^|[._\- ])+(ts|metadata|data))$", re.IGNORECASE
)
"""What a table's name says besides its camera's."""
_SINCE_1970_NS = 946_684_800_000_000_000
"""Later times, from the year 2000 on, are dates; earlier ones count from some start."""


def find_tables(sources: Sequence[Source], root: Path) -> tuple[Sequence[Table], list[str]]:
    """Return the tables of times in the sources' folders, or in folders above up to `root`, if they fit.

    One table with a column of cameras is taken. Tables of one camera each are taken if their times are dates
    that overlap. Otherwise each may count from its own start, which only the user can know. Return also what
    was found.
    """
    notes: list[str] = []
    columns: dict[Path, Collection[str]] = {}
    for path in _files_near(sources, root):
        with suppress(BadInputError):
            columns[path] = read_columns(path)[0].keys()
    timed = [path for path, names in columns.items() if not TIME_COLUMNS.keys().isdisjoint(names)]
    own = [path for path in timed if set(CAMERA_COLUMNS).isdisjoint(columns[path])]
    # https://www.cvlibs.net/datasets/kitti/eval_odometry.php: the times of all cameras' synchronized images.
    common = [
        [(source.name, path) for source in sources]
        for path in own
        if path.name == COMMON_TIMES and all(path.parent in _with_parents(one.path) for one in sources)
    ]
    tried = (*([("", path)] for path in timed if path not in own), _of_cameras(own, sources), *common)
    return next((tables for tables in tried if tables and _fit(sources, tables, notes)), ()), notes


def name_tables(tables: Sequence[Table], sources: Sequence[Source]) -> list[Table]:
    """Return tables that are given without a camera's name with the one that their files' names have."""
    if len(tables) < 2 or any(name for name, _ in tables):
        return list(tables)
    return _of_cameras([path for _, path in tables], sources) or list(tables)


def _fit(sources: Sequence[Source], tables: Sequence[Table], notes: list[str]) -> bool:
    """Return whether tables fit the recording, and one clock gave them; add a line about it to `notes`."""
    names = ", ".join(path.name for _, path in tables)
    try:
        timeline, _ = timeline_by_tables(sources, tables)
        require_overlap(timeline)
    except BadInputError as error:
        notes.append(f"times: {names}: not taken: {error}")
        return False
    cameras = timeline.cameras()
    counts = {
        f"{len(cameras[one.name])} of {len(one.numbers)} frames": one.label or one.name for one in sources
    }
    fits = "; ".join(counts if len(counts) == 1 else (f"{name}: {text}" for text, name in counts.items()))
    # Only tables can show whether their times are of one clock.
    firsts_ns = [min(frame.leader_ns for frame in frames) for frames in cameras.values()]
    why = ""
    if len({path for _, path in tables}) < len(tables):
        names = tables[0][1].name
    elif len(firsts_ns) > 1 and not any(firsts_ns):
        why = "each camera counts from 0 in it"
    elif len(tables) > 1 and min(firsts_ns) < _SINCE_1970_NS:
        why = "each may count from its camera's own start"
    if why:
        given = " ".join(
            f"--timestamps {command_line(f'{name}={path}' if name else str(path))}" for name, path in tables
        )
        fits += f", not taken: {why}; if one clock gave them: {given}"
    notes.append(f"times: {names}{': ' if why else ', '}{fits}")
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
        # Two videos of one name do not show which table is whose.
        if len(labels) == len(sources):
            return [(name, stems[labels[label]]) for name, label in zip(names, own, strict=True)]
    # A table alone in its camera's folder; in the deepest one, if there are several.
    folders = sorted({path.resolve().parent for path in paths}, key=lambda folder: len(folder.parts))
    inside = {folder: [path for path in paths if path.resolve().parent == folder] for folder in folders}
    of = {folder: [one.name for one in sources if folder in _with_parents(one.path)] for folder in folders}
    alone = {
        of[folder][0]: inside[folder][0] for folder in folders if len(inside[folder]) == len(of[folder]) == 1
    }
    return [(name, alone[name]) for name in names] if len(alone) == len(names) else []
