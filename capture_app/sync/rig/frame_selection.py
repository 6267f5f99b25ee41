"""A burst's instants in leader time, and the frames a client picks for them."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from capture_app.camera_facts import EXACT_STAMPS, StampAccuracy
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.aligner import Aligner
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.phase.stamps import StampError

F = TypeVar("F")


RING_NS = 3_000_000_000
RING_BYTES = 256_000_000


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


MAX_FRAMES, MAX_BURST_NS = 1000, 600_000_000_000
"""The longest burst whose frames are told after the last, and the longest time from its first to its last."""
MAX_STREAMED_FRAMES, MAX_STREAMED_NS = 100_000_000, 31 * 86_400_000_000_000
"""The longest burst whose frames are sent as they come, and the longest time that it lasts."""

DROPPED = "the camera dropped the frame"
"""The reason of a gap where the frames before and after it came."""
NO_FRAME_OF_ITS_OWN = "the camera's frames are further apart than the instants"
"""The reason of a gap where the nearest frame is that of the instant before."""


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


def is_possible_burst(frames: int, step_ns: int, *, streamed: bool = False) -> bool:
    """Whether a burst of so many frames, so far apart in ns, is within the limits."""
    most, most_ns = (MAX_STREAMED_FRAMES, MAX_STREAMED_NS) if streamed else (MAX_FRAMES, MAX_BURST_NS)
    return 0 < frames <= most and step_ns > 0 and (frames - 1) * step_ns <= most_ns


def burst_instants(grid: FrameGrid, at_leader_ns: int, frames: int, spacing: int) -> range:
    """Snap a moment to the rig's grid and return the burst's instants from there, in leader ns."""
    first_ns, step_ns = grid.instant(grid.index_of(at_leader_ns)), spacing * grid.period_ns
    return range(first_ns, first_ns + frames * step_ns, step_ns)


@dataclass(frozen=True, slots=True)
class FrameTiming:
    """What tells when a camera's frames were, in leader time."""

    time_map: TimeMap
    offset_ns: int = 0
    """From a frame's timestamp to its aligned moment, which is what a pick tells."""
    accuracy: StampAccuracy = EXACT_STAMPS
    """How well that is known."""
    aligner: Aligner | None = None
    """Knows how far a timestamp is off its stream's line: a stamp may be late though the frame is not."""

    def pick(self, frame: F, stamp_ns: int, instant: int, instant_ns: int) -> SelectedFrame[F]:
        """Return the pick of a frame for an instant; `stamp_ns` is as the driver told it."""
        error = StampError() if self.aligner is None else self.aligner.phase.stamp_error(stamp_ns)
        time_map, accuracy = self.time_map, self.accuracy
        local_ns = stamp_ns - error.outlier_ns + self.offset_ns
        leader_ns = time_map.leader_from_local(local_ns)
        bound_ns = round(time_map.hard_bound_at(local_ns) + error.hard_bound_ns)
        return SelectedFrame(
            instant,
            local_ns,
            leader_ns,
            residual_ns=leader_ns - instant_ns,
            uncertainty_ns=round(
                time_map.uncertainty_at(local_ns) + error.uncertainty_ns + accuracy.uncertainty_ns
            ),
            hard_bound_ns=bound_ns if accuracy.is_exact else None,
            outlier_ns=error.outlier_ns,
            frame=frame,
            alignment_offset_ns=self.offset_ns,
        )


def select_frame(
    ring: RingBuffer[F], timing: FrameTiming, instant: int, instant_ns: int, period_ns: int
) -> SelectedFrame[F] | Gap:
    """Return the frame nearest to an instant, or why there is none within half a period."""
    wanted_ns = timing.time_map.local_from_leader(instant_ns) - timing.offset_ns
    nearest = ring.nearest(wanted_ns)
    if nearest is None:
        return Gap(instant, "the camera gave no frames")
    stamp_ns, frame = nearest
    pick = timing.pick(frame, stamp_ns, instant, instant_ns)
    if abs(pick.residual_ns) > period_ns // 2:
        late = stamp_ns == ring.oldest_local_ns and stamp_ns > wanted_ns
        return Gap(instant, "it had left the ring buffer" if late else DROPPED)
    return pick
