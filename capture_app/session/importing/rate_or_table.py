"""Matching of frames to instants by a constant rate or by a table of times."""

import csv
import statistics
from collections.abc import Mapping, Sequence
from contextlib import suppress
from decimal import Decimal
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

from capture_app.common.bounds import CENTURY_NS
from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_text, rejecting
from capture_app.session.format.camera_labels import describe_pairs, pair_labels
from capture_app.session.importing.frame_matching import (
    Instant,
    TimedFrame,
    Timeline,
    check_order,
    middle,
    timeline_by_times,
)
from capture_app.session.importing.name_numbers import frame_numbers
from capture_app.session.importing.recording_sources import Source

_CAMERA = ("camera", "cam_id", "cam", "port", "camera_id")
_FRAME = ("frame", "frame_index", "frame_number")
_GROUP = ("sync_index", "instant")
_TIMES = {"time": 9, "frame_time": 9, "timestamp": 9, "time_s": 9, "time_ms": 6, "time_us": 3, "time_ns": 0}
"""Column names of a time, and the power of ten that converts their unit to ns."""


_Row = tuple[str, int | None, str | None, int | None]
"""A row's camera, frame number, sync_index and time in ns; None for an empty cell or no such column."""
_Timed = list[tuple[str | None, TimedFrame]]
"""The frames of a camera that have a time, each with its sync_index."""


def times_by_rate(sources: Sequence[Source], fps: float) -> dict[str, list[TimedFrame]]:
    """Return the frames of each camera, 1/fps apart by their numbers; number 0 is at 0 ns.

    Raises BadInputError for an invalid rate.
    """
    period, numbers = _period_of(fps), _numbers(sources)
    return {
        name: [TimedFrame(index, round(number * period)) for index, number in enumerate(of)]
        for name, of in numbers.items()
    }


def timeline_by_rate(sources: Sequence[Source], fps: float) -> Timeline:
    """Match frames of equal number to one instant, 1/fps apart; the lowest number is at 0 ns.

    Raises BadInputError for an invalid rate, or if no two cameras share a number.
    """
    period, numbers = _period_of(fps), _numbers(sources)
    indices = {name: {number: index for index, number in enumerate(of)} for name, of in numbers.items()}
    every = sorted(set().union(*indices.values()))
    shared = [number for number in every if sum(number in index for index in indices.values()) > 1]
    if len(sources) > 1 and not shared:
        raise BadInputError(
            "no two cameras share a frame number",
            hint="frames of one instant need the same number in their file names; else use --timestamps",
        )
    times_ns = {number: round((number - every[0]) * period) for number in every}
    instants = [
        Instant(at_ns, {name: TimedFrame(index[n], at_ns) for name, index in indices.items() if n in index})
        for n, at_ns in times_ns.items()
    ]
    return Timeline(instants, round(period), dict.fromkeys(indices, round(period)))


def timeline_by_table(sources: Sequence[Source], path: Path) -> Timeline:
    """Match frames by a CSV with columns camera, time, and a frame number or a sync_index.

    Rows with the same sync_index are one instant, and the rows of a camera are its frames in order. Without a
    sync_index, frames less than half a period apart are one instant. An empty time is a dropped frame. Raises
    BadInputError, with the line, if the table contradicts itself or the recording.
    """
    rows = _read_table(path, sources)
    timed = {source.name: _timed_frames(path, source.name, rows, len(source.numbers)) for source in sources}
    periods = {name: _period(path, name, [frame.leader_ns for _, frame in of]) for name, of in timed.items()}
    cameras = {
        name: sorted((frame for _, frame in of), key=lambda frame: frame.index) for name, of in timed.items()
    }
    if any(group is None for _, _, group, _ in rows):
        return timeline_by_times(str(path), cameras)
    for name, frames in cameras.items():
        check_order(f"{path}: camera {name}", frames)
    instants = _by_group(path, rows, timed)
    for before, after in pairwise(instants):
        if after.leader_ns <= before.leader_ns:
            raise BadInputError(
                f"{path}: two instants are at the same time, {after.leader_ns} ns",
                hint="give each instant its own sync_index and time",
            )
    return Timeline(instants, round(statistics.median(periods.values())), periods)


def _period_of(fps: float) -> Fraction:
    if not 0.001 <= fps <= 1e6:
        raise BadInputError(f"frame rate {fps:g} is out of range (0.001 to 1e6)", hint="for example --fps 60")
    return 1_000_000_000 / Fraction(str(fps))


def numbers_of_frames(sources: Sequence[Source]) -> dict[str, Sequence[int]] | None:
    """Return each camera's frame numbers; None if some camera has none, so that only the order counts."""
    names = {source.name: source.name_numbers for source in sources}
    return frame_numbers(names) if all(names.values()) else None


def _numbers(sources: Sequence[Source]) -> Mapping[str, Sequence[int]]:
    return numbers_of_frames(sources) or {source.name: range(len(source.numbers)) for source in sources}


def _read_table(path: Path, sources: Sequence[Source]) -> list[_Row]:
    text = read_text(path)
    delimiter = next((mark for mark in ",;\t" if mark in text.partition("\n")[0]), ",")
    reader = csv.DictReader(text.splitlines(), delimiter=delimiter, skipinitialspace=True)
    with rejecting(f"cannot read the table {path}", csv.Error, hint="save it as comma-separated values"):
        columns = {str(name).strip().lower(): str(name) for name in reader.fieldnames or ()}
        lines = [(f"{path}, line {reader.line_num}", line) for line in reader]
    camera, time, frame, group = (
        next((columns[name] for name in known if name in columns), None)
        for known in (_CAMERA, _TIMES, _FRAME, _GROUP)
    )
    if camera is None or time is None or (frame is None and group is None):
        raise BadInputError(
            f"{path} has the columns {', '.join(columns) or '(none)'}",
            hint=f"it needs {_CAMERA[0]}, {_FRAME[0]} or {_GROUP[0]}, and one of {', '.join(_TIMES)}",
        )
    ns = 10 ** _TIMES[time.strip().lower()]
    labels = list(dict.fromkeys((line[camera] or "").strip() for _, line in lines))
    pairs = pair_labels(labels, [source.name for source in sources])
    names = {label: name for name, label in pairs.items()}
    rows = [
        (
            name,
            _parse(where, line[frame], None) if frame else None,
            (line[group] or "").strip() if group else None,
            _parse(where, line[time], ns),
        )
        for where, line in lines
        if (name := names.get((line[camera] or "").strip())) is not None
    ]
    timed = {camera for camera, _, _, at_ns in rows if at_ns is not None}
    if lacking := [source.name for source in sources if source.name not in timed]:
        raise BadInputError(
            f"{path} has no times of camera {lacking[0]}; it names {', '.join(labels) or 'none'}",
            hint="add its rows; the column camera must have the names of the imported cameras",
        )
    if said := describe_pairs(path.name, pairs, labels):
        sources[0].note = "; ".join(filter(None, (sources[0].note, said)))
    return rows


def _parse(where: str, text: str | None, ns: int | None) -> int | None:
    """Parse a cell: a time in units of `ns`, or a frame number if `ns` is None; None for an empty cell."""
    cell = (text or "").strip()
    if not cell:
        return None
    with suppress(ArithmeticError, ValueError):
        number = Decimal(int(cell)) if ns is None else Decimal(cell) * ns
        if abs(number) <= CENTURY_NS:
            return round(number)
    raise BadInputError(
        f"{where}: {text!r} is not {'a time' if ns else 'a frame number'}",
        hint=f"write a number such as {'12.5' if ns else '12'}; leave the cell of a dropped frame empty",
    )


def _timed_frames(path: Path, name: str, rows: Sequence[_Row], count: int) -> _Timed:
    """Return the frames of a camera that have a time; without frame numbers they are in the times' order."""
    own = [(at_ns, n, group) for camera, n, group, at_ns in rows if camera == name and at_ns is not None]
    numbers = [n for _, n, _ in own if n is not None]
    if len(numbers) < len(own):
        if len(own) != count:
            raise BadInputError(
                f"{path} has {len(own)} times of camera {name}, which has {count} frames",
                hint="add the column frame: the number of each frame, from 0",
            )
        own.sort(key=lambda row: row[0])
        numbers = list(range(count))
    if wrong := [number for number in numbers if not 0 <= number < count]:
        raise BadInputError(
            f"{path} names frame {wrong[0]} of camera {name}, which has {count} frames",
            hint="correct the column frame, which counts from 0",
        )
    if len(set(numbers)) < len(numbers):
        raise BadInputError(f"{path} names a frame of camera {name} twice", hint="remove one of the two rows")
    return [(group, TimedFrame(n, at_ns)) for n, (at_ns, _, group) in zip(numbers, own, strict=True)]


def _period(path: Path, name: str, times_ns: Sequence[int]) -> int:
    steps = [after - before for before, after in pairwise(sorted(times_ns))]
    if min(steps, default=0) <= 0:
        raise BadInputError(
            f"{path}: camera {name} has {'a time twice' if steps else 'only one time'}",
            hint="each camera needs two different times or more",
        )
    return round(statistics.median(steps))


def _by_group(path: Path, rows: Sequence[_Row], timed: Mapping[str, _Timed]) -> list[Instant]:
    groups: dict[str | None, dict[str, TimedFrame]] = {}
    for name, of in timed.items():
        for group, frame in of:
            if groups.setdefault(group, {}).setdefault(name, frame) is not frame:
                raise BadInputError(
                    f"{path} has instant {group} of camera {name} twice", hint="remove one of the two rows"
                )
    dropped = {(group, camera) for camera, _, group, at_ns in rows if at_ns is None}
    reason = "dropped by the camera: the table gives no time"
    instants = (
        Instant(middle(frames), frames, {name: reason for name in timed if (group, name) in dropped})
        for group, frames in groups.items()
    )
    return sorted(instants, key=lambda instant: instant.leader_ns)
