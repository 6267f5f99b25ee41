"""The bursts that a client has accepted, until their frames are picked, whether its leader lives or not."""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.frame_stamp import PhaseEstimate
from capture_app.sync.rig.events import BurstPicked
from capture_app.sync.rig.frame_picks import RingBuffer, pick_frames
from capture_app.sync.rig.phase_loop import CameraGrid
from capture_app.sync.wire.messages import Trigger

F = TypeVar("F")

PATIENCE_PERIODS = 30
"""So long after a burst's last instant a camera without frames is waited for."""


class PendingBursts(Generic[F]):
    """Triggers of one tree's root, by its run and their number, whichever relay has brought them."""

    def __init__(self) -> None:
        self._triggers: dict[tuple[int, int], Trigger] = {}
        self._done: deque[tuple[int, int]] = deque(maxlen=64)

    def __bool__(self) -> bool:
        """Whether any burst is still to be picked."""
        return bool(self._triggers)

    def clear(self) -> None:
        """Forget all bursts: those of another root are in another time."""
        self._triggers.clear()
        self._done.clear()

    def add(self, trigger: Trigger) -> None:
        """Add a burst; a trigger that comes again changes nothing."""
        key = trigger.leader, trigger.burst
        if key not in self._done:
            self._triggers[key] = trigger

    def first_before(self, leader_ns: int) -> tuple[int, int] | None:
        """First and last instant of the earliest burst that has begun, or does before a leader time in ns."""
        spans = [
            (t.first_leader_ns, t.first_leader_ns + (t.count - 1) * t.step_ns)
            for t in self._triggers.values()
        ]
        return min((span for span in spans if span[0] <= leader_ns), default=None)

    def pick_due(
        self,
        ring: RingBuffer[F],
        grid: CameraGrid,
        time_map: TimeMap,
        now_ns: int,
        *,
        outlier_ns: Callable[[int], int],
        phase: Callable[[int], PhaseEstimate | None],
    ) -> list[BurstPicked[F]]:
        """Pick the frames of all bursts whose last frame is there, or waited for no longer.

        `outlier_ns` as for `pick_frames`; `phase` tells the stream's at a local time in ns.
        """
        newest_ns, goal, offset_ns = ring.newest_local_ns, grid.goal, grid.offset_ns
        due = []
        for key, trigger in list(self._triggers.items()):
            instants_ns = tuple(trigger.first_leader_ns + k * trigger.step_ns for k in range(trigger.count))
            last_local_ns = time_map.local_from_leader(instants_ns[-1]) - offset_ns
            seen = newest_ns is not None and newest_ns > last_local_ns + goal.period_ns // 2
            if not seen and now_ns < last_local_ns + PATIENCE_PERIODS * goal.period_ns:
                continue
            del self._triggers[key]
            self._done.append(key)
            picks, gaps = pick_frames(
                ring, time_map, instants_ns, goal.period_ns, offset_ns=offset_ns, outlier_ns=outlier_ns
            )
            last_phase = phase(last_local_ns)
            due.append(BurstPicked(trigger.leader, trigger.burst, picks, gaps, time_map, last_phase))
        return due
