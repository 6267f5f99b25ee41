"""A burst's instants in leader time, and the frames a client picks for them."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.goal import Goal

F = TypeVar("F")


class RingBuffer(Generic[F]):
    """Holds the last `capacity` frames with their timestamps in ns of the local clock."""

    def __init__(self, capacity: int) -> None:
        self._entries: deque[tuple[int, F]] = deque(maxlen=capacity)

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, local_ns: int, frame: F) -> None:
        """Keep a frame; the oldest goes when the buffer is full."""
        self._entries.append((local_ns, frame))

    @property
    def oldest_local_ns(self) -> int | None:
        """Timestamp of the oldest frame, None where there is none."""
        return self._entries[0][0] if self._entries else None

    @property
    def newest_local_ns(self) -> int | None:
        """Timestamp of the newest frame, None where there is none."""
        return self._entries[-1][0] if self._entries else None

    def nearest(self, local_ns: int) -> tuple[int, F] | None:
        """Return the timestamp and the frame nearest to a local time in ns; the earlier one of a tie."""
        return min(self._entries, key=lambda entry: abs(entry[0] - local_ns), default=None)


MAX_FRAMES = 1000
"""The longest burst a leader asks for; a client's ring buffer sets its own limit on the past."""
MAX_BURST_NS = 600_000_000_000
"""The longest time from a burst's first instant to its last."""

DROPPED = "the camera dropped the frame"
"""The reason of a gap where the frames before and after it came."""


@dataclass(frozen=True, slots=True)
class Burst:
    """A burst as the leader ordered it: instants in leader time, ns, on the rig's grid."""

    number: int
    instants_ns: tuple[int, ...]
    period_ns: int
    requested_ns: int
    clients: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Pick(Generic[F]):
    """The frame picked for an instant; times in ns, the error bars those of its leader time.

    `outlier_ns` is how far the driver's own stamp lay off the line of its stream's frames; where that is not
    0 the times are the line's.
    """

    instant: int
    local_ns: int
    leader_ns: int
    residual_ns: int
    uncertainty_ns: int
    hard_bound_ns: int
    outlier_ns: int
    frame: F
    alignment_offset_ns: int = 0
    """From the timestamp to the aligned moment of the frame, which `local_ns` and `leader_ns` tell."""

    @property
    def stamp_leader_ns(self) -> int:
        """Leader time of the frame's timestamp itself."""
        return self.leader_ns - self.alignment_offset_ns


@dataclass(frozen=True, slots=True)
class Gap:
    """An instant without a frame, and why."""

    instant: int
    reason: str


def is_possible_burst(frames: int, step_ns: int) -> bool:
    """Whether a burst of so many frames, so far apart in ns, is within the limits."""
    return 0 < frames <= MAX_FRAMES and step_ns > 0 and (frames - 1) * step_ns <= MAX_BURST_NS


def burst_instants(goal: Goal, at_leader_ns: int, frames: int, spacing: int) -> tuple[int, ...]:
    """Snap a moment to the rig's grid and return the burst's instants from there, in leader ns."""
    first = goal.index_of(at_leader_ns)
    return tuple(goal.instant(first + k * spacing) for k in range(frames))


def pick_frames(
    ring: RingBuffer[F],
    time_map: TimeMap,
    instants_ns: tuple[int, ...],
    period_ns: int,
    *,
    offset_ns: int = 0,
    outlier_ns: Callable[[int], int] = lambda _: 0,
) -> tuple[tuple[Pick[F], ...], tuple[Gap, ...]]:
    """Return the frame nearest to each instant, and the instants that have none within half a period.

    `offset_ns` is the time from a frame's timestamp to its aligned moment, which the picks tell. `outlier_ns`
    says how far a timestamp is off its stream's line: a stamp may be late though the frame is not.
    """
    picks: list[Pick[F]] = []
    gaps: list[Gap] = []
    for instant, leader_ns in enumerate(instants_ns):
        wanted_local_ns = time_map.local_from_leader(leader_ns) - offset_ns
        nearest = ring.nearest(wanted_local_ns)
        if nearest is None:
            gaps.append(Gap(instant, "the camera gave no frames"))
            continue
        stamp_ns, frame = nearest
        off_ns = outlier_ns(stamp_ns)
        local_ns = stamp_ns - off_ns + offset_ns
        frame_leader_ns = time_map.leader_from_local(local_ns)
        residual_ns = frame_leader_ns - leader_ns
        if abs(residual_ns) > period_ns // 2:
            late = stamp_ns == ring.oldest_local_ns and stamp_ns > wanted_local_ns
            reason = "it had left the ring buffer" if late else DROPPED
            gaps.append(Gap(instant, reason))
            continue
        errors_ns = round(time_map.uncertainty_at(local_ns)), round(time_map.hard_bound_at(local_ns))
        times_ns = local_ns, frame_leader_ns, residual_ns
        picks.append(Pick(instant, *times_ns, *errors_ns, off_ns, frame, offset_ns))
    return tuple(picks), tuple(gaps)
