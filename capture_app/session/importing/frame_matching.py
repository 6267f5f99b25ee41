"""Matching of frames to instants by their times alone."""

import statistics
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import combinations, pairwise
from typing import Any

from capture_app.common.bounds import CENTURY_NS
from capture_app.common.errors import BadInputError
from capture_app.common.grouping import grouped
from capture_app.common.instants import is_same_instant
from capture_app.common.text import Talk, count
from capture_app.session.format.common_times import CameraTimes, CommonTimes

LONE_PERIOD_NS = 33_333_333
"""Period that is assumed if every camera has only one frame."""
NO_FRAME = "no frame within half a period"
MAX_GAP_NS = 1_000_000_000
"""Maximum time between the end of one camera and the beginning of another in one recording."""
OTHER_RATE = 1.1
"""Minimum ratio of frame periods for which one camera is slower. Below it, one lost frames, or drifts."""
MIN_STEPS = 5
REGULAR = 0.25
"""Maximum relative difference of an interval from the median that counts as regular."""
MIN_REGULAR = 0.7
"""Minimum fraction of regular intervals for a recording to have a rate at all."""
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
        return grouped(named for instant in self.instants for named in instant.frames.items())


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


def require_overlap(timeline: Timeline) -> None:
    """Raise BadInputError if two cameras' times never meet."""
    spans = {name: (frames[0].leader_ns, frames[-1].leader_ns) for name, frames in timeline.cameras().items()}
    for (first, span), (second, other) in combinations(spans.items(), 2):
        gap_ns = max(span[0], other[0]) - min(span[1], other[1])
        if gap_ns > max(MAX_GAP_NS, 2 * timeline.period_ns):
            raise BadInputError(
                f"the times of {first} and {second} never meet: {gap_ns / 1e9:.1f} s pass between them, and "
                f"{abs(span[0] - other[0]) / 1e9:.1f} s between their beginnings",
                hint="if each counts from its own start, or one is an hour off by summer time, give the "
                "difference: --time-shift-ms CAMERA=MS",
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
    times_ns = [frame.leader_ns for frame in frames.values()]
    # Exact: times since 1970 in ns have more digits than a float.
    return round(Fraction(statistics.median_low(times_ns) + statistics.median_high(times_ns), 2))


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


def trim(timeline: Timeline) -> tuple[Timeline, str]:
    """Return the part of a timeline in which all cameras run, at the slowest rate, and a note."""
    said: list[str] = []
    timeline = at_slowest_rate(overlap(timeline, said.append), said.append)
    return timeline, "; ".join(said)


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
    """Return a timeline with the instants of the slowest cameras, with the others' nearest frames.

    Where the slowest lack a frame, an instant of the others remains in its place.
    """
    periods = timeline.camera_periods_ns
    slowest_ns = max(periods.values())
    if slowest_ns < OTHER_RATE * min(periods.values()):
        return timeline
    slow = {name for name, period_ns in periods.items() if period_ns > slowest_ns / OTHER_RATE}
    slow_ns = [instant.leader_ns for instant in timeline.instants if not slow.isdisjoint(instant.frames)]
    instants: list[Instant] = []
    for one in timeline.instants:
        after = bisect_right(slow_ns, one.leader_ns)
        near_ns = [*(instant.leader_ns for instant in instants[-1:]), *slow_ns[after : after + 1]]
        is_alone = all(abs(one.leader_ns - at_ns) > 0.7 * slowest_ns for at_ns in near_ns)
        if is_alone or not slow.isdisjoint(one.frames):
            instants.append(one)
    # Of cameras that are little faster, a frame may have been nearest to an instant that is left out.
    others = {name: frames for name, frames in timeline.cameras().items() if name not in slow}
    paired = [_with_nearest(instant, others, slowest_ns) for instant in instants]
    fast = ", ".join(
        f"{name} {1e9 / period_ns:.4g}" for name, period_ns in periods.items() if name not in slow
    )
    talk(
        f"{fast} frames a second, {', '.join(sorted(slow))} {1e9 / slowest_ns:.4g}: the nearest are taken, "
        f"{count(len(timeline.instants) - len(instants), 'instant')} between are left out"
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


@dataclass(frozen=True, slots=True)
class Times:
    """Times of a recording's frames, and what is known of them; `common` is None for a single camera."""

    timeline: Timeline
    common: CommonTimes | None
    by_rate: bool
    """Whether a rate gives the times, instead of the frames' own ones."""
    notes: Sequence[str] = ()


def with_common_times(timeline: Timeline, common: CommonTimes) -> Timeline:
    """Return a timeline of the cameras with common times, converted to these and matched again."""
    cameras = {
        name: [_at_common_time(frame, common.cameras[name]) for frame in frames]
        for name, frames in timeline.cameras().items()
        if name in common.cameras
    }
    return timeline_by_times("the recording", cameras)


def _at_common_time(frame: TimedFrame, times: CameraTimes) -> TimedFrame:
    own_ns = frame.leader_ns if frame.local_ns is None else frame.local_ns
    further = {**frame.further, "uncertainty_ns": times.uncertainty_at_ns(own_ns)}
    return replace(frame, leader_ns=times.leader_from_local(own_ns), local_ns=own_ns, further=further)


def describe_times(times_ns: Sequence[int]) -> str:
    """Describe the frames that are missing or came twice by ascending times (ns); "" if there are none."""
    steps_ns = [after - before for before, after in pairwise(times_ns)]
    period_ns = statistics.median(steps_ns) if len(steps_ns) >= MIN_STEPS else 0
    if not period_ns:
        return ""
    regular = sum(abs(step - period_ns) <= REGULAR * period_ns for step in steps_ns) / len(steps_ns)
    if regular < MIN_REGULAR:
        return ""

    def describe(what: str, counts: Mapping[int, int]) -> str:
        frame, total = min(counts), sum(counts.values())
        frames = f"{count(total, 'frame')} {'is' if total == 1 else 'are'} {what}"
        places = "" if len(counts) == 1 else f" in {len(counts)} places, the first"
        at_s, step_ms = (times_ns[frame] - times_ns[0]) / 1e9, steps_ns[frame] / 1e6
        interval = f"{step_ms:.1f} ms pass instead of {period_ns / 1e6:.1f}"
        return f"{frames}{places} after frame {frame} ({at_s:.2f} s), where {interval}"

    extra = find_extra_steps(steps_ns, period_ns)
    missing = {frame: frames for frame, frames in extra.items() if frames > 0}
    doubled = {frame: -frames for frame, frames in extra.items() if frames < 0}
    return "; ".join(
        describe(what, instants)
        for what, instants in (("missing", missing), ("doubled", doubled))
        if instants
    )


def find_extra_steps(steps_ns: Sequence[int], period_ns: float) -> dict[int, int]:
    """Return the number of frames missing after a frame (negative: too many) by its number, from intervals.

    A late or early frame, whose next one is on time, is none of them: neighbouring intervals make up for it.
    """
    gaps: dict[int, int] = {}
    for number, step_ns in enumerate(steps_ns):
        extra = round(step_ns / period_ns) - 1
        if extra * gaps.get(number - 1, 0) < 0:
            extra += gaps.pop(number - 1)
        if extra:
            gaps[number] = extra
    return gaps
