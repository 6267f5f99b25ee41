"""A burst's instants in leader time, and the frames a client picks for them."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from msgspec import structs

from capture_app.common.camera_facts import EXACT_STAMPS, CameraFacts, StampAccuracy
from capture_app.common.instants import is_same_instant
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.aligner import Aligner
from capture_app.sync.phase.estimator import PhaseEstimate, PhaseEstimator, StampError
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.wire.messages import RigConfigMessage, Trigger

F = TypeVar("F")


RING_NS = 3_000_000_000
RING_BYTES = 256_000_000
MAX_FRAMES, MAX_BURST_NS = 1000, 600_000_000_000
"""The longest burst whose frames are told after the last, and the longest time from its first to its last."""
MAX_STREAMED_FRAMES, MAX_STREAMED_NS = 100_000_000, 31 * 86_400_000_000_000
"""The longest burst whose frames are sent as they come, and the longest time that it lasts."""
DROPPED = "the camera dropped the frame"
"""The reason of a gap where the frames before and after it came."""
NO_FRAME_OF_ITS_OWN = "the camera's frames are further apart than the instants"
"""The reason of a gap where the nearest frame is that of the instant before."""
PATIENCE_PERIODS = 30
"""How long after an instant a camera without frames is waited for."""
PAUSE_NS = 5_000_000_000
"""Between two instants that are so far apart a stream may be moved."""


class RingBuffer(Generic[F]):
    """Holds the frames of the last `span_ns`, with their timestamps in ns of the local clock.

    They may take `most_bytes` of memory; the newest two are kept in any case.
    """

    def __init__(self, span_ns: int = RING_NS, most_bytes: int = RING_BYTES) -> None:
        self._span_ns, self._most_bytes = span_ns, most_bytes
        self._entries: deque[tuple[int, F, int]] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, local_ns: int, frame: F, size_bytes: int = 0) -> None:
        """Keep a frame; the oldest go where they are too old, or take too much memory."""
        self._entries.append((local_ns, frame, size_bytes))
        self._bytes += size_bytes
        # A clock that was set back leaves frames from its future.
        while len(self._entries) > 2 and (
            abs(local_ns - self._entries[0][0]) > self._span_ns or self._bytes > self._most_bytes
        ):
            self._bytes -= self._entries.popleft()[2]

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
        nearest = min(self._entries, key=lambda entry: abs(entry[0] - local_ns), default=None)
        return None if nearest is None else nearest[:2]


@dataclass(frozen=True, slots=True)
class Burst:
    """A burst as the leader ordered it: instants in leader time, ns, on the rig's grid."""

    number: int
    instants_ns: Sequence[int]
    period_ns: int
    requested_ns: int
    clients: tuple[str, ...]
    spare: int = 0
    """How many of the last instants only make up for those that not every camera has."""
    streamed: bool = False
    """Its frames are sent as they come, and not after the last."""
    video: bool = False
    """They go into a video for each camera."""

    @property
    def frames(self) -> int:
        """How many complete instants were asked for."""
        return len(self.instants_ns) - self.spare


@dataclass(frozen=True, slots=True)
class SelectedFrame(Generic[F]):
    """The frame picked for an instant; times in ns, the error bars those of its leader time.

    They are the clock's and, on top, those of the stamp: of its bias, its scatter, and the steps that it
    comes in.
    `outlier_ns` is how far the driver's own stamp lay off the line of its stream's frames; where that is not
    0 the times are the line's.
    """

    instant: int
    local_ns: int
    leader_ns: int
    residual_ns: int
    uncertainty_ns: int
    hard_bound_ns: int | None
    """None where the stamp has none, as that of no real camera."""
    outlier_ns: int
    frame: F
    alignment_offset_ns: int = 0
    """From the timestamp to the aligned moment of the frame, which `local_ns` and `leader_ns` tell."""

    @property
    def stamp_leader_ns(self) -> int:
        """Leader time of the frame's timestamp itself."""
        return self.leader_ns - self.alignment_offset_ns

    @property
    def stamp_ns(self) -> int:
        """The frame's timestamp in local time, as the driver told it."""
        return self.local_ns - self.alignment_offset_ns + self.outlier_ns


@dataclass(frozen=True, slots=True)
class Gap:
    """An instant without a frame, and why."""

    instant: int
    reason: str


@dataclass(frozen=True, slots=True)
class FramesSelected(Generic[F]):
    """Frames of a burst are picked: save and send them."""

    trigger: Trigger
    """What was ordered, as it stands now."""
    frames: tuple[SelectedFrame[F], ...]
    """In the order of their instants."""
    gaps: tuple[Gap, ...]
    """The instants without a frame."""
    time_map: TimeMap
    """By which the frames were picked."""
    phase: PhaseEstimate | None
    """The stream's phase at the last instant; None where it was not known."""
    further: bool = False
    """They add to what was told of the burst before: spare instants, or the next of one that is streamed."""
    over: int = 0
    """How many instants have been told, these included."""

    @property
    def ended(self) -> bool:
        """Whether no further frames will come."""
        return self.over >= self.trigger.count


def is_possible_burst(frames: int, step_ns: int, *, streamed: bool = False) -> bool:
    """Whether a burst of so many frames, so far apart in ns, is within the limits."""
    most, most_ns = (MAX_STREAMED_FRAMES, MAX_STREAMED_NS) if streamed else (MAX_FRAMES, MAX_BURST_NS)
    return 0 < frames <= most and step_ns > 0 and (frames - 1) * step_ns <= most_ns


def burst_instants(grid: FrameGrid, at_leader_ns: int, frames: int, spacing: int) -> range:
    """Snap a moment to the rig's grid and return the burst's instants from there, in leader ns."""
    first_ns, step_ns = grid.instant(grid.index_of(at_leader_ns)), spacing * grid.period_ns
    return range(first_ns, first_ns + frames * step_ns, step_ns)


@dataclass(frozen=True, slots=True)
class CameraGrid:
    """The rig's grid of instants as one camera's timestamps see it, and when its frames were; times in ns."""

    rig_grid: FrameGrid
    offset_ns: int = 0
    """From a frame's timestamp to its aligned moment, as well as that is known: that is what a pick tells."""
    accuracy: StampAccuracy = EXACT_STAMPS
    """How well it is known."""
    why_no_centre: str = ""
    """Why the middle of the exposure is not aligned though it was asked for; empty where it is."""
    meeting_leader_ns: int | None = None
    stream: PhaseEstimator | None = None
    """Knows how far a timestamp is off its stream's line: a stamp may be late though the frame is not."""

    @classmethod
    def of_camera(cls, camera: CameraFacts, config: RigConfigMessage, stream: PhaseEstimator) -> "CameraGrid":
        """Return the grid of that configuration for a camera and its stream."""
        row = config.align_row
        start_ns = camera.start_offset_ns()
        known_ns = start_ns if row is None else camera.mid_exposure_offset_ns(row)
        problem = "its rows or exposure are not known: it is aligned by its timestamps, not by a row's centre"
        return cls(
            FrameGrid(config.anchor_leader_ns, config.period_ns),
            start_ns if known_ns is None else known_ns,
            camera.stamp_accuracy,
            "" if known_ns is not None else problem,
            config.meeting_leader_ns,
            stream,
        )

    @property
    def grid_of_stamps(self) -> FrameGrid:
        """The grid that the frames' timestamps should lie on."""
        return FrameGrid(self.rig_grid.anchor_leader_ns - self.offset_ns, self.rig_grid.period_ns)

    def wanted_ns(self, time_map: TimeMap, instant_ns: int) -> int:
        """Return the timestamp, in local time, that a frame of an instant of leader time should have."""
        return time_map.local_from_leader(instant_ns) - self.offset_ns

    def pick(self, time_map: TimeMap, frame: F, stamp_ns: int, instant: int, at_ns: int) -> SelectedFrame[F]:
        """Return the pick of a frame for an instant at `at_ns` of leader time; `stamp_ns` is the driver's."""
        error = StampError() if self.stream is None else self.stream.stamp_error(stamp_ns)
        local_ns = stamp_ns - error.outlier_ns + self.offset_ns
        leader_ns = time_map.leader_from_local(local_ns)
        bound_ns = round(time_map.hard_bound_at(local_ns) + error.hard_bound_ns)
        uncertainty_ns = time_map.uncertainty_at(local_ns) + error.uncertainty_ns
        return SelectedFrame(
            instant,
            local_ns,
            leader_ns,
            residual_ns=leader_ns - at_ns,
            uncertainty_ns=round(uncertainty_ns + self.accuracy.uncertainty_ns),
            hard_bound_ns=bound_ns if self.accuracy.is_exact else None,
            outlier_ns=error.outlier_ns,
            frame=frame,
            alignment_offset_ns=self.offset_ns,
        )

    def select(
        self, ring: RingBuffer[F], time_map: TimeMap, instant: int, at_ns: int
    ) -> SelectedFrame[F] | Gap:
        """Return the frame nearest to an instant, or why there is none within half a period."""
        wanted_ns = self.wanted_ns(time_map, at_ns)
        nearest = ring.nearest(wanted_ns)
        if nearest is None:
            return Gap(instant, "the camera gave no frames")
        stamp_ns, frame = nearest
        pick = self.pick(time_map, frame, stamp_ns, instant, at_ns)
        if not is_same_instant(pick.residual_ns, self.rig_grid.period_ns):
            late = stamp_ns == ring.oldest_local_ns and stamp_ns > wanted_ns
            return Gap(instant, "it had left the ring buffer" if late else DROPPED)
        return pick


@dataclass(slots=True)
class _PendingBurst(Generic[F]):
    """A burst whose frames are set aside as they come: the ring buffer may not reach back to the first."""

    trigger: Trigger
    picked: list[SelectedFrame[F] | Gap] = field(default_factory=list)
    """Selected frames and gaps that are not told yet."""
    told: int = 0
    """How many instants have been told."""
    time_map: TimeMap | None = None
    """The map by which they were told: one burst has one map, but for one that is streamed."""
    last_stamp_ns: int | None = None
    """Timestamp of the last frame that was selected."""

    @property
    def over(self) -> int:
        """How many instants are over."""
        return self.told + len(self.picked)

    @property
    def has_news(self) -> bool:
        """Whether there is something to tell.

        Spare instants are told one by one, those before together; of a burst that is streamed each by itself.
        """
        if self.trigger.streamed:
            return bool(self.picked) or self.over >= self.trigger.count
        return bool(self.picked) and self.over >= self.trigger.count - self.trigger.spare

    @property
    def span_ns(self) -> tuple[int, int]:
        """Leader times between which the stream should not be moved, in ns."""
        if self.trigger.streamed and self.trigger.step_ns >= PAUSE_NS:
            return self.instant_ns(self.over), self.instant_ns(self.over)
        return self.instant_ns(0), self.instant_ns(self.trigger.count - 1)

    def instant_ns(self, instant: int) -> int:
        """Leader time in ns."""
        return self.trigger.first_leader_ns + instant * self.trigger.step_ns

    def once(self, picked: SelectedFrame[F] | Gap) -> SelectedFrame[F] | Gap:
        """The same, but a gap where its frame is that of the instant before: one further away is none."""
        if isinstance(picked, Gap):
            return picked
        if picked.stamp_ns == self.last_stamp_ns:
            return Gap(picked.instant, NO_FRAME_OF_ITS_OWN)
        self.last_stamp_ns = picked.stamp_ns
        return picked

    def tell(
        self, picks: tuple[SelectedFrame[F], ...], time_map: TimeMap, phase: PhaseEstimate | None
    ) -> FramesSelected[F]:
        """What is new of it: the picks with their times by this map, and what is a gap."""
        further = self.told > 0
        gaps = tuple(gap for gap in self.picked if isinstance(gap, Gap))
        self.told, self.time_map = self.over, time_map
        self.picked.clear()
        return FramesSelected(self.trigger, picks, gaps, time_map, phase, further, self.told)


class PendingBursts(Generic[F]):
    """Triggers of one tree's root, by its run and their number, whichever relay has brought them."""

    def __init__(self) -> None:
        self._pending: dict[tuple[int, int], _PendingBurst[F]] = {}
        self._done: deque[tuple[int, int]] = deque(maxlen=64)

    def __bool__(self) -> bool:
        """Whether any burst is still to be picked."""
        return bool(self._pending)

    def clear(self) -> list[FramesSelected[F]]:
        """Forget all bursts, as those of another root are in another time; return how those under way end."""
        ends = []
        for burst in self._pending.values():
            if burst.trigger.streamed and burst.time_map is not None:
                burst.trigger = structs.replace(burst.trigger, count=burst.told)
                burst.picked.clear()
                ends.append(burst.tell((), burst.time_map, None))
        self._pending.clear()
        self._done.clear()
        return ends

    def add(self, trigger: Trigger) -> None:
        """Add a burst; a trigger that comes again can only end one that is streamed earlier."""
        key = trigger.leader, trigger.burst
        if key in self._done:
            return
        known = self._pending.setdefault(key, _PendingBurst(trigger))
        if known.trigger.streamed and trigger.count < known.trigger.count:
            known.trigger = structs.replace(known.trigger, count=max(trigger.count, known.over))

    def forget(self, leader: int, burst: int) -> None:
        """Select nothing more of a burst, also should its trigger come again."""
        self._pending.pop((leader, burst), None)
        if (leader, burst) not in self._done:
            self._done.append((leader, burst))

    def first_before(self, leader_ns: int) -> tuple[int, int] | None:
        """First and last instant of the earliest burst that has begun, or does before a leader time in ns.

        Of one with long pauses it is the next instant alone: between two of them the stream may be moved.
        """
        spans = [burst.span_ns for burst in self._pending.values() if burst.over < burst.trigger.count]
        return min((span for span in spans if span[0] <= leader_ns), default=None)

    def select_due(
        self,
        ring: RingBuffer[F],
        aligner: Aligner,
        grid: CameraGrid,
        time_map: TimeMap,
        now_ns: int,
        *,
        is_member: bool,
    ) -> list[FramesSelected[F]]:
        """Select the frames of all bursts whose last frame is there, or waited for no longer.

        Spare instants are told after that, each when it is over; the stream's phase only by a member.
        """
        due = []
        for key, burst in list(self._pending.items()):
            for instant in range(burst.over, burst.trigger.count):
                instant_ns = burst.instant_ns(instant)
                if not _is_over(instant_ns, ring, grid, time_map, now_ns):
                    break
                burst.picked.append(burst.once(grid.select(ring, time_map, instant, instant_ns)))
            if burst.has_news:
                newest = burst.trigger.streamed or burst.time_map is None
                by = time_map if newest else burst.time_map or time_map
                last_ns = grid.wanted_ns(by, burst.instant_ns(max(0, burst.over - 1)))
                at_ns = time_map.leader_from_local(last_ns)
                phase = aligner.estimate(time_map, grid.grid_of_stamps, at_ns) if is_member else None
                picks = (
                    grid.pick(by, pick.frame, pick.stamp_ns, pick.instant, burst.instant_ns(pick.instant))
                    for pick in burst.picked
                    if isinstance(pick, SelectedFrame)
                )
                due.append(burst.tell(tuple(picks), by, phase))
            if burst.told == burst.trigger.count:
                self.forget(*key)
        return due


def _is_over(at_ns: int, ring: RingBuffer[F], grid: CameraGrid, time_map: TimeMap, now_ns: int) -> bool:
    """Whether the frame of an instant of leader time has come, or is waited for no longer."""
    newest_ns, period_ns = ring.newest_local_ns, grid.rig_grid.period_ns
    wanted_ns = grid.wanted_ns(time_map, at_ns)
    seen = newest_ns is not None and newest_ns > wanted_ns + period_ns // 2
    return seen or now_ns >= wanted_ns + PATIENCE_PERIODS * period_ns
