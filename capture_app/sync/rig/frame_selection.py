"""Instants of a burst in leader time, and the frames that a client selects for them."""

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
from capture_app.sync.wire.datagrams import RigConfigMessage, Trigger

F = TypeVar("F")
"""The node's type of a frame."""

RING_NS, RING_BYTES = 3_000_000_000, 256_000_000
"""Length of a ring buffer, which covers a trigger's delay and TIMEOUT_PERIODS at 30 fps, and its maximum
size: half of a Raspberry Pi's smallest memory."""
SAME_GRID_NS = 10_000
"""Maximum phase of a burst's instants on the grid that they are taken from."""
MAX_FRAMES, MAX_BURST_NS = 1000, 600_000_000_000
"""Maximum frames of a burst that is reported after its last frame, and maximum time from first to last."""
MAX_STREAMED_FRAMES, MAX_STREAMED_NS = 100_000_000, 31 * 86_400_000_000_000
"""Maximum frames of a burst that is streamed, and its maximum duration."""
DROPPED = "the camera dropped the frame"
"""Reason of a gap when the frames before and after it arrived."""
MOVED, LONG_FRAMES = "a longer frame took its time, which keeps the camera in phase", 3
"""Reason of a gap at a move of the phase, and the frames that a move may lengthen."""
NOT_STARTED = "its node was not running yet"
"""Reason of a gap before the first frame that a node has had."""
GAVE_NONE, GAVE_NONE_PERIODS = "the camera gave no frames", 15
"""Reason of a gap further than so many periods from any frame: its camera, or its node, stood still."""
SLEPT = "its machine slept"
"""Reason of a gap before the first frame after a sleep of the machine."""
LEFT_RING = "it had left the ring buffer"
"""Reason of a gap before the oldest frame in the ring buffer."""
NO_FRAME_OF_ITS_OWN = "the camera's frames are further apart than the instants"
"""Reason of a gap when the nearest frame belongs to the previous instant."""
TIMEOUT_PERIODS = 30
"""Periods after an instant until which a frame is awaited if the camera delivers none."""
PAUSE_NS = 5_000_000_000
"""Minimum time between two instants during which a stream may be moved."""


class RingBuffer(Generic[F]):
    """Ring buffer of the frames of the last `span_ns`, with their timestamps in ns of the local clock.

    They may use `max_bytes` of memory; the newest two are always stored.
    """

    def __init__(self, span_ns: int = RING_NS, max_bytes: int = RING_BYTES) -> None:
        self._span_ns, self._max_bytes = span_ns, max_bytes
        self._entries: deque[tuple[int, F, int]] = deque()
        self._bytes = 0
        self.first_local_ns: int | None = None
        """Timestamp of the first frame since the start or since a sleep, or None."""
        self.why_before = NOT_STARTED
        """Reason why there are no earlier frames."""

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, local_ns: int, frame: F, size_bytes: int = 0) -> None:
        """Store a frame, and drop the oldest ones that exceed the time span or the memory."""
        if not self._entries:
            if self.first_local_ns is not None and local_ns < self.first_local_ns:
                return  # it was taken before the machine slept
            self.first_local_ns = local_ns
        self._entries.append((local_ns, frame, size_bytes))
        self._bytes += size_bytes
        # A clock that was set back leaves frames with future timestamps.
        while len(self._entries) > 2 and (
            abs(local_ns - self._entries[0][0]) > self._span_ns or self._bytes > self._max_bytes
        ):
            self._bytes -= self._entries.popleft()[2]

    def clear_after_sleep(self, local_ns: int) -> None:
        """Remove all frames, as the machine slept until `local_ns`."""
        self._entries.clear()
        self._bytes, self.first_local_ns, self.why_before = 0, local_ns, SLEPT

    @property
    def oldest_local_ns(self) -> int | None:
        """Timestamp of the oldest frame, or None."""
        return self._entries[0][0] if self._entries else None

    @property
    def newest_local_ns(self) -> int | None:
        """Timestamp of the newest frame, or None."""
        return self._entries[-1][0] if self._entries else None

    def nearest(self, local_ns: int) -> tuple[int, F] | None:
        """Return the frame nearest to a local time in ns, with its timestamp; the earlier one wins a tie."""
        nearest = min(self._entries, key=lambda entry: abs(entry[0] - local_ns), default=None)
        return None if nearest is None else nearest[:2]


@dataclass(frozen=True, slots=True)
class Burst:
    """Burst as the leader ordered it; its instants are in leader time, ns, on the rig's grid."""

    number: int
    instants_ns: Sequence[int]
    period_ns: int
    requested_ns: int
    clients: tuple[str, ...]
    spare: int = 0
    """Number of final instants that only replace instants which some camera misses."""
    streamed: bool = False
    """Whether its frames are sent as they arrive, instead of after the last one."""
    video: bool = False
    """Whether the frames become a video per camera."""

    @property
    def frames(self) -> int:
        """Requested number of complete instants."""
        return len(self.instants_ns) - self.spare

    @property
    def step_ns(self) -> int:
        """Time between two instants; the frame period for a single one."""
        first_ns, *further_ns = self.instants_ns[:2]
        return further_ns[0] - first_ns if further_ns else self.period_ns


@dataclass(frozen=True, slots=True)
class SelectedFrame(Generic[F]):
    """Frame selected for an instant; times in ns, with the uncertainty of the leader time.

    The uncertainty and the hard bound add the clock's to the timestamp's: from its bias, scatter and
    quantization. `outlier_ns` is the residual of the driver's timestamp from the line through its stream's
    frames. If it is not 0, the times are taken from the line.
    """

    instant: int
    local_ns: int
    leader_ns: int
    residual_ns: int
    uncertainty_ns: int
    hard_bound_ns: int | None
    """None if the timestamp has no bound, as for every real camera."""
    outlier_ns: int
    frame: F
    alignment_offset_ns: int = 0
    """Time from the timestamp to the aligned moment of the frame, which `local_ns` and `leader_ns` refer
    to."""

    @property
    def stamp_leader_ns(self) -> int:
        """Leader time of the frame's timestamp itself."""
        return self.leader_ns - self.alignment_offset_ns

    @property
    def stamp_ns(self) -> int:
        """Timestamp of the frame in local time, as reported by the driver."""
        return self.local_ns - self.alignment_offset_ns + self.outlier_ns


@dataclass(frozen=True, slots=True)
class Gap:
    """Instant for which a camera has no frame, and the reason."""

    instant: int
    reason: str


@dataclass(frozen=True, slots=True)
class FramesSelected(Generic[F]):
    """Selected frames of a burst, to be saved and sent."""

    trigger: Trigger
    """Trigger of the burst in its latest version."""
    frames: tuple[SelectedFrame[F], ...]
    """Selected frames in the order of their instants."""
    gaps: tuple[Gap, ...]
    """Instants without a frame."""
    time_map: TimeMap
    """Map used for the selection."""
    phase: PhaseEstimate | None
    """Phase of the stream at the last instant; None if unknown."""
    further: bool = False
    """Whether they add to an earlier report of the burst: spare instants, or the next ones of a streamed
    burst."""
    over: int = 0
    """Number of instants reported so far, including these."""

    @property
    def ended(self) -> bool:
        """Whether no further frames will follow."""
        return self.over >= self.trigger.count


def burst_limits(*, streamed: bool) -> tuple[int, int]:
    """Return the maximum frames of a burst, and the maximum time from its first to its last, in ns."""
    return (MAX_STREAMED_FRAMES, MAX_STREAMED_NS) if streamed else (MAX_FRAMES, MAX_BURST_NS)


def is_open_ended(count: int, step_ns: int) -> bool:
    """Return whether a streamed burst of `count` instants goes on until an operator ends it."""
    return count >= min(MAX_STREAMED_FRAMES, MAX_STREAMED_NS // max(1, step_ns))


def is_possible_burst(frames: int, step_ns: int, *, streamed: bool = False) -> bool:
    """Whether a burst of that many frames, `step_ns` apart, is within the limits."""
    max_frames, max_ns = burst_limits(streamed=streamed)
    return 0 < frames <= max_frames and step_ns > 0 and (frames - 1) * step_ns <= max_ns


def burst_instants(grid: FrameGrid, at_leader_ns: int, frames: int, spacing: int) -> range:
    """Return a burst's instants in leader ns, the first snapped to the rig's grid."""
    first_ns, step_ns = grid.instant(grid.index_of(at_leader_ns)), spacing * grid.period_ns
    return range(first_ns, first_ns + frames * step_ns, step_ns)


@dataclass(frozen=True, slots=True)
class CameraGrid:
    """Rig's grid of instants in one camera's timestamps; times in ns."""

    rig_grid: FrameGrid
    offset_ns: int = 0
    """Time from a frame's timestamp to its aligned moment, as accurately as known; a selected frame's times
    include it."""
    accuracy: StampAccuracy = EXACT_STAMPS
    """Uncertainty of this offset."""
    why_no_centre: str = ""
    """Reason why the middle of the exposure is not aligned although requested; empty if it is aligned."""
    common_instant_leader_ns: int | None = None
    delay_ns: int = 0
    """Planned time of this camera's frames after the rig's instants, in a staggered rig."""
    stream: PhaseEstimator | None = None
    """Estimator of the residual of a timestamp from its stream's line: a timestamp may be late though the
    frame is not."""

    @classmethod
    def of_camera(
        cls, camera: CameraFacts, config: RigConfigMessage, stream: PhaseEstimator, delay_ns: int = 0
    ) -> "CameraGrid":
        """Return the grid of that configuration for a camera, its stream and its planned delay."""
        row = config.align_row
        start_ns = camera.start_offset_ns()
        known_ns = start_ns if row is None else camera.mid_exposure_offset_ns(row)
        problem = "its rows or exposure are not known: it is aligned by its timestamps, not by a row's centre"
        return cls(
            FrameGrid(config.anchor_leader_ns, config.period_ns),
            start_ns if known_ns is None else known_ns,
            camera.stamp_accuracy,
            "" if known_ns is not None else problem,
            config.common_instant_leader_ns,
            delay_ns,
            stream,
        )

    @property
    def grid_of_stamps(self) -> FrameGrid:
        """Grid that the frames' timestamps should match."""
        return FrameGrid(
            self.rig_grid.anchor_leader_ns - self.offset_ns + self.delay_ns, self.rig_grid.period_ns
        )

    def target_ns(self, time_map: TimeMap, instant_ns: int) -> int:
        """Return the target timestamp, in local time, of a frame for an instant of leader time."""
        return time_map.local_from_leader(instant_ns + self.delay_ns) - self.offset_ns

    def pick(self, time_map: TimeMap, frame: F, stamp_ns: int, instant: int, at_ns: int) -> SelectedFrame[F]:
        """Return a frame as selected for an instant at leader time `at_ns`; `stamp_ns` is the driver's."""
        error = StampError() if self.stream is None else self.stream.stamp_error(stamp_ns)
        local_ns = stamp_ns - error.outlier_ns + self.offset_ns
        leader_ns = time_map.leader_from_local(local_ns)
        bound_ns = round(time_map.hard_bound_at(local_ns) + error.hard_bound_ns)
        uncertainty_ns = time_map.uncertainty_at(local_ns) + error.uncertainty_ns
        return SelectedFrame(
            instant,
            local_ns,
            leader_ns,
            residual_ns=leader_ns - at_ns - self.delay_ns,
            uncertainty_ns=round(uncertainty_ns + self.accuracy.uncertainty_ns),
            hard_bound_ns=bound_ns if self.accuracy.is_exact else None,
            outlier_ns=error.outlier_ns,
            frame=frame,
            alignment_offset_ns=self.offset_ns,
        )

    def _is_near_move(self, stamp_ns: int) -> bool:
        near_ns = LONG_FRAMES * self.rig_grid.period_ns
        return self.stream is not None and abs(self.stream.run_begun_ns - stamp_ns) <= near_ns

    def select(
        self, ring: RingBuffer[F], time_map: TimeMap, instant: int, at_ns: int
    ) -> SelectedFrame[F] | Gap:
        """Return the frame nearest to an instant, or a gap if none is within half a period."""
        target_ns, first_ns = self.target_ns(time_map, at_ns), ring.first_local_ns
        if (nearest := ring.nearest(target_ns)) is not None:
            stamp_ns, frame = nearest
            pick = self.pick(time_map, frame, stamp_ns, instant, at_ns)
            if is_same_instant(pick.residual_ns, self.rig_grid.period_ns):
                return pick
            if stamp_ns != ring.oldest_local_ns or stamp_ns < target_ns:
                is_far = abs(stamp_ns - target_ns) > GAVE_NONE_PERIODS * self.rig_grid.period_ns
                reason = MOVED if self._is_near_move(target_ns) else DROPPED
                return Gap(instant, GAVE_NONE if is_far else reason)
        if first_ns is not None and target_ns < first_ns:
            return Gap(instant, ring.why_before)
        return Gap(instant, GAVE_NONE if nearest is None else LEFT_RING)


@dataclass(slots=True)
class _Selection(Generic[F]):
    """Burst whose frames are selected as they arrive, as they may leave the ring buffer before its end."""

    trigger: Trigger
    picked: list[SelectedFrame[F] | Gap] = field(default_factory=list)
    """Selected frames and gaps that are not reported yet."""
    reported: int = 0
    """Number of instants reported so far."""
    time_map: TimeMap | None = None
    """Map used for the reported frames: one per burst, except for a streamed burst."""
    last_stamp_ns: int | None = None
    """Timestamp of the last selected frame."""
    timed: int = 0
    """Number of first instants whose frames keep their times, as the machine slept after them."""

    @property
    def over(self) -> int:
        """Number of instants that are over."""
        return self.reported + len(self.picked)

    @property
    def has_events(self) -> bool:
        """Whether there is anything to report.

        Spare instants are reported one by one, the instants before them together. Each instant of a streamed
        burst is reported by itself.
        """
        if self.trigger.streamed:
            return bool(self.picked) or self.over >= self.trigger.count
        return bool(self.picked) and self.over >= self.trigger.count - self.trigger.spare

    @property
    def span_ns(self) -> tuple[int, int]:
        """Leader times in ns between which the stream should not be moved."""
        if self.trigger.streamed and self.trigger.step_ns >= PAUSE_NS:
            return self.instant_ns(self.over), self.instant_ns(self.over)
        return self.instant_ns(0), self.instant_ns(self.trigger.count - 1)

    def instant_ns(self, instant: int) -> int:
        """Return the leader time of an instant, in ns."""
        return self.trigger.first_leader_ns + instant * self.trigger.step_ns

    def once(self, picked: SelectedFrame[F] | Gap) -> SelectedFrame[F] | Gap:
        """Return the selection, or a gap if its frame was already selected for the previous instant."""
        if isinstance(picked, Gap):
            return picked
        if picked.stamp_ns == self.last_stamp_ns:
            return Gap(picked.instant, NO_FRAME_OF_ITS_OWN)
        self.last_stamp_ns = picked.stamp_ns
        return picked

    def report(
        self, picks: tuple[SelectedFrame[F], ...], time_map: TimeMap, phase: PhaseEstimate | None
    ) -> FramesSelected[F]:
        """Return the unreported frames, with times by this map, and the unreported gaps."""
        further = self.reported > 0
        gaps = tuple(gap for gap in self.picked if isinstance(gap, Gap))
        self.reported, self.time_map = self.over, time_map
        self.picked.clear()
        return FramesSelected(self.trigger, picks, gaps, time_map, phase, further, self.reported)


class FrameSelection(Generic[F]):
    """Pending bursts by root instance and burst number, whichever relay forwarded the trigger."""

    def __init__(self, before: "FrameSelection[F] | None" = None) -> None:
        """`before` is the selection of the leader before this one: what it has completed stays so."""
        self._pending: dict[tuple[int, int], _Selection[F]] = {}
        self._done: deque[tuple[int, int]] = deque(() if before is None else before._done, maxlen=64)

    def __contains__(self, burst: tuple[int, int]) -> bool:
        """Return whether frames of a burst, by root instance and number, are still to be selected."""
        return burst in self._pending

    def __bool__(self) -> bool:
        """Whether frames of any burst are still to be selected."""
        return bool(self._pending)

    def is_recording(self, grid: FrameGrid) -> bool:
        """Whether streamed bursts alone are pending, have begun, and have their instants on this grid."""
        pending = self._pending.values()
        return bool(self) and all(
            burst.trigger.streamed
            and burst.over
            and abs(grid.phase_error(burst.instant_ns(burst.over))) < SAME_GRID_NS
            for burst in pending
        )

    def keep_times(self) -> None:
        """Let the frames that are selected already keep their times: another map holds from now on."""
        for burst in self._pending.values():
            burst.timed = burst.over

    def keep_ordered(self, *, has_time: bool = True) -> list[FramesSelected[F]]:
        """Keep only the streamed bursts with an ordered end; return the ends of the other streamed ones.

        None is kept unless their time is known.
        """
        ends, kept = [], {}
        for key, burst in self._pending.items():
            if not burst.trigger.streamed:
                continue
            if has_time and not is_open_ended(burst.trigger.count, burst.trigger.step_ns):
                kept[key] = burst
            elif burst.time_map is not None:
                burst.trigger = structs.replace(burst.trigger, count=burst.reported)
                burst.picked.clear()
                ends.append(burst.report((), burst.time_map, None))
        self._pending = kept
        return ends

    def take_over(self, other: "FrameSelection[F]") -> None:
        """Take the bursts out of another selection, whose time is the same."""
        self._pending |= other._pending
        other._pending = {}

    def add(self, trigger: Trigger) -> None:
        """Add a burst; a repeated trigger can only end a streamed burst earlier."""
        key = trigger.leader, trigger.burst
        if key in self._done:
            return
        known = self._pending.setdefault(key, _Selection(trigger))
        if known.trigger.streamed and trigger.count < known.trigger.count:
            known.trigger = structs.replace(known.trigger, count=max(trigger.count, known.over))

    def forget(self, leader: int, burst: int) -> None:
        """Select nothing more of a burst, even if its trigger is repeated."""
        self._pending.pop((leader, burst), None)
        if (leader, burst) not in self._done:
            self._done.append((leader, burst))

    def first_before(self, leader_ns: int) -> tuple[int, int] | None:
        """Return the first and last instant of the earliest burst that begins before a leader time in ns.

        Bursts already under way are included. Between two instants with a long pause the stream may be moved:
        then only the next instant is returned.
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
        is_last: bool = False,
    ) -> list[FramesSelected[F]]:
        """Select the frames of all bursts whose last frame has arrived or timed out.

        If the newest frame `is_last`, as the camera has failed, nothing nearer to its instant comes.
        Spare instants are reported afterwards, each when it is over. Only a member reports the stream's
        phase.
        """
        due = []
        for key, burst in list(self._pending.items()):
            for instant in range(burst.over, burst.trigger.count):
                instant_ns = burst.instant_ns(instant)
                if not _is_over(instant_ns, ring, grid, time_map, now_ns, is_last=is_last):
                    break
                burst.picked.append(burst.once(grid.select(ring, time_map, instant, instant_ns)))
            if burst.has_events:
                by = time_map if burst.trigger.streamed or burst.timed else burst.time_map or time_map
                last_ns = grid.target_ns(by, burst.instant_ns(max(0, burst.over - 1)))
                at_ns = time_map.leader_from_local(last_ns)
                phase = aligner.estimate(time_map, grid.grid_of_stamps, at_ns) if is_member else None
                picks = (
                    pick
                    if pick.instant < burst.timed
                    else grid.pick(
                        by, pick.frame, pick.stamp_ns, pick.instant, burst.instant_ns(pick.instant)
                    )
                    for pick in burst.picked
                    if isinstance(pick, SelectedFrame)
                )
                due.append(burst.report(tuple(picks), by, phase))
            if burst.reported == burst.trigger.count:
                self.forget(*key)
        return due


def _is_over(
    at_ns: int,
    ring: RingBuffer[F],
    grid: CameraGrid,
    time_map: TimeMap,
    now_ns: int,
    *,
    is_last: bool,
) -> bool:
    """Whether the frame of an instant of leader time has arrived or timed out."""
    newest_ns, period_ns = ring.newest_local_ns, grid.rig_grid.period_ns
    target_ns = grid.target_ns(time_map, at_ns)
    # A later frame might be nearer, unless none comes.
    after_ns = -(period_ns // 2) if is_last else period_ns // 2
    seen = newest_ns is not None and newest_ns > target_ns + after_ns
    return seen or now_ns >= target_ns + TIMEOUT_PERIODS * period_ns
