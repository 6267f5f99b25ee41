"""The bursts that a client has accepted, until their frames are picked, whether its leader lives or not."""

from collections import deque
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from msgspec.structs import replace

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.stamps import PhaseEstimate
from capture_app.sync.rig.events import FramesSelected
from capture_app.sync.rig.frame_selection import (
    NO_FRAME_OF_ITS_OWN,
    FrameTiming,
    Gap,
    RingBuffer,
    SelectedFrame,
    select_frame,
)
from capture_app.sync.rig.phase_loop import CameraGrid, PhaseLoop
from capture_app.sync.wire.messages import Trigger

F = TypeVar("F")

PATIENCE_PERIODS = 30
"""How long after an instant a camera without frames is waited for."""
PAUSE_NS = 5_000_000_000
"""Between two instants that are so far apart a stream may be moved."""


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
        under_way = [burst for burst in self._pending.values() if burst.trigger.streamed]
        ends = [_end(burst, burst.time_map) for burst in under_way if burst.time_map is not None]
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
            known.trigger = replace(known.trigger, count=max(trigger.count, known.over))

    def forget(self, leader: int, burst: int) -> None:
        """SelectedFrame nothing more of a burst, also should its trigger come again."""
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
        loop: PhaseLoop,
        grid: CameraGrid,
        time_map: TimeMap,
        now_ns: int,
        *,
        is_member: bool,
    ) -> list[FramesSelected[F]]:
        """SelectedFrame the frames of all bursts whose last frame is there, or waited for no longer.

        Spare instants are told after that, each when it is over; the stream's phase only by a member.
        """
        due = []
        timing = grid.timing(time_map, loop)
        for key, burst in list(self._pending.items()):
            for instant in range(burst.over, burst.trigger.count):
                instant_ns = burst.instant_ns(instant)
                if not _is_over(instant_ns, ring, grid, time_map, now_ns):
                    break
                picked = select_frame(ring, timing, instant, instant_ns, grid.rig_grid.period_ns)
                burst.picked.append(burst.once(picked))
            if burst.has_news:
                newest = burst.trigger.streamed or burst.time_map is None
                by = time_map if newest else burst.time_map or time_map
                last_ns = by.local_from_leader(burst.instant_ns(max(0, burst.over - 1))) - grid.offset_ns
                phase = loop.phase(grid, time_map, last_ns) if is_member else None
                due.append(_tell(burst, grid.timing(by, loop), phase))
            if burst.told == burst.trigger.count:
                self.forget(*key)
        return due


def _is_over(instant_ns: int, ring: RingBuffer[F], grid: CameraGrid, time_map: TimeMap, now_ns: int) -> bool:
    """Whether an instant's frame has come, or is waited for no longer."""
    newest_ns, period_ns = ring.newest_local_ns, grid.rig_grid.period_ns
    wanted_ns = time_map.local_from_leader(instant_ns) - grid.offset_ns
    seen = newest_ns is not None and newest_ns > wanted_ns + period_ns // 2
    return seen or now_ns >= wanted_ns + PATIENCE_PERIODS * period_ns


def _tell(burst: _PendingBurst[F], timing: FrameTiming, phase: PhaseEstimate | None) -> FramesSelected[F]:
    """What is new of a burst, with the times by this timing."""
    picks = tuple(
        timing.pick(pick.frame, pick.stamp_ns, pick.instant, burst.instant_ns(pick.instant))
        for pick in burst.picked
        if isinstance(pick, SelectedFrame)
    )
    gaps = tuple(gap for gap in burst.picked if isinstance(gap, Gap))
    further = burst.told > 0
    burst.told, burst.time_map = burst.over, timing.time_map
    burst.picked.clear()
    return _event(burst, timing.time_map, phase, picks, gaps, further)


def _end(burst: _PendingBurst[F], time_map: TimeMap) -> FramesSelected[F]:
    """That nothing further comes of a burst of which some was told, as its leader is another one."""
    burst.trigger = replace(burst.trigger, count=burst.told)
    return _event(burst, time_map, None, (), (), True)


def _event(
    burst: _PendingBurst[F],
    time_map: TimeMap,
    phase: PhaseEstimate | None,
    picks: tuple[SelectedFrame[F], ...],
    gaps: tuple[Gap, ...],
    further: bool,
) -> FramesSelected[F]:
    trigger = burst.trigger
    streamed = trigger if trigger.streamed else None
    return FramesSelected(
        trigger.leader, trigger.burst, picks, gaps, time_map, phase, further, streamed, burst.told
    )
