"""Matching of frames to instants by their times alone."""

import statistics
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from capture_app.common.bounds import CENTURY_NS
from capture_app.common.errors import BadInputError
from capture_app.common.instants import is_same_instant

LONE_PERIOD_NS = 33_333_333
"""Period that is assumed if every camera has only one frame."""
NO_FRAME = "no frame within half a period"
_CORRECT = "correct these times, or give the rate instead: --fps"


@dataclass(frozen=True, slots=True)
class TimedFrame:
    """A frame of a source: its time in ns by the recording's common clock, and by its own camera's clock."""

    index: int
    leader_ns: int
    local_ns: int | None = None
    further: Mapping[str, Any] = field(default_factory=dict)
    """Other fields of its ImageRecord that the recording contains."""


@dataclass(frozen=True, slots=True)
class Instant:
    """The frames of one instant by camera, and the instant's time in ns."""

    leader_ns: int
    frames: Mapping[str, TimedFrame]
    why_missing: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Timeline:
    """All instants in order; periods in ns, of the grid and of each camera."""

    instants: Sequence[Instant]
    period_ns: int
    camera_periods_ns: Mapping[str, int]

    def cameras(self) -> dict[str, list[TimedFrame]]:
        """Return the frames of each camera, in the order of the instants."""
        cameras: dict[str, list[TimedFrame]] = {}
        for instant in self.instants:
            for name, frame in instant.frames.items():
                cameras.setdefault(name, []).append(frame)
        return cameras


def timeline_by_times(where: str, cameras: Mapping[str, Sequence[TimedFrame]]) -> Timeline:
    """Match frames, in capture order, by their times; `where` is the source named in errors.

    Each frame of the camera with the most frames is an instant; it gets the nearest frame of every other
    camera within half a period. Frames that are near none of these become instants of their own. An instant's
    time is the median of its frames'. Raises BadInputError if times decrease.
    """
    for name, frames in cameras.items():
        check_order(f"{where}: camera {name}", frames)
    periods = periods_of(cameras)
    period_ns = round(statistics.median(periods.values()))
    instants = [
        Instant(middle(frames), frames, {name: NO_FRAME for name in cameras if name not in frames})
        for frames in match(cameras, period_ns)
    ]
    return Timeline(sorted(instants, key=lambda instant: instant.leader_ns), period_ns, periods)


def match(cameras: Mapping[str, Sequence[TimedFrame]], period_ns: int) -> list[dict[str, TimedFrame]]:
    """Group each camera's frames, sorted by time, into instants; see `timeline_by_times`."""
    lead = max(cameras, key=lambda name: len(cameras[name]))
    groups: list[dict[str, TimedFrame]] = [{lead: frame} for frame in cameras[lead]]
    lead_ns = [frame.leader_ns for frame in cameras[lead]]
    left: list[tuple[int, str, TimedFrame]] = []
    for name, frames in cameras.items():
        for frame in frames if name != lead else ():
            number = nearest(lead_ns, frame.leader_ns)
            offset_ns = abs(lead_ns[number] - frame.leader_ns)
            rest: TimedFrame | None = frame
            if is_same_instant(offset_ns, period_ns):
                rival = groups[number].get(name)
                if rival is None or offset_ns < abs(lead_ns[number] - rival.leader_ns):
                    groups[number][name], rest = frame, rival
            if rest is not None:
                left.append((rest.leader_ns, name, rest))
    return groups + _group(sorted(left, key=lambda one: one[:2]), period_ns)


def check_order(where: str, frames: Sequence[TimedFrame]) -> None:
    """Raise BadInputError if a time is out of range, or a frame was not taken after the previous one."""
    if wild := [frame.index for frame in frames if abs(frame.leader_ns) > CENTURY_NS]:
        raise BadInputError(f"{where}: the time of frame {wild[0]} is out of range", hint=_CORRECT)
    for before, after in pairwise(frames):
        if after.leader_ns <= before.leader_ns:
            back_ms = (before.leader_ns - after.leader_ns) / 1e6
            how = f"is {back_ms:g} ms before" if back_ms else "is at the same time as"
            raise BadInputError(
                f"{where}: times go backwards: frame {after.index} {how} frame {before.index}",
                hint=_CORRECT,
            )


def periods_of(cameras: Mapping[str, Sequence[TimedFrame]]) -> dict[str, int]:
    """Return the median frame interval of each camera in ns; a camera with one frame gets the others'."""
    steps = {
        name: [after.leader_ns - before.leader_ns for before, after in pairwise(frames)]
        for name, frames in cameras.items()
    }
    known = {name: round(statistics.median(step)) for name, step in steps.items() if step}
    common = round(statistics.median(known.values())) if known else LONE_PERIOD_NS
    return {name: known.get(name, common) for name in cameras}


def middle(frames: Mapping[str, TimedFrame]) -> int:
    """Return the median of the frames' times, in ns."""
    return round(statistics.median(frame.leader_ns for frame in frames.values()))


def nearest(times_ns: Sequence[int], at_ns: int) -> int:
    """Return the place of the time that is nearest to another, in ascending ones."""
    after = bisect_left(times_ns, at_ns)
    around = [number for number in (after - 1, after) if 0 <= number < len(times_ns)]
    return min(around, key=lambda number: abs(times_ns[number] - at_ns))


def _group(frames: Sequence[tuple[int, str, TimedFrame]], period_ns: int) -> list[dict[str, TimedFrame]]:
    groups: list[dict[str, TimedFrame]] = []
    first_ns = 0
    for at_ns, name, frame in frames:
        if not groups or name in groups[-1] or not is_same_instant(at_ns - first_ns, period_ns):
            groups.append({})
            first_ns = at_ns
        groups[-1][name] = frame
    return groups
