"""What phones with the app are to do and when: single pictures, recordings, and their phase in between."""

from collections.abc import Sequence
from dataclasses import dataclass

STILL_EVERY_NS = 500_000_000
"""The app keeps one trigger at a time, and saves a picture before the next: it takes none in between."""
AGAIN_EVERY_NS, LAST_CALL_NS = 100_000_000, 100_000_000
"""A trigger is repeated, as nothing acknowledges it, but not near its time: it would be obeyed twice."""
QUIET_BEFORE_NS, QUIET_AFTER_NS = 3_000_000_000, 1_000_000_000
"""Phones do not move their phase so long before a picture, and after it: it takes five long frames, 2 s."""


@dataclass(slots=True)
class _Still:
    """A picture to come: its instant, and when its trigger is sent, first and next; leader time in ns."""

    instant_ns: int
    trigger_ns: int
    due_ns: int


class AppOrders:
    """The orders of all phones; `now_ns` is leader time."""

    def __init__(self) -> None:
        self.is_recording = False
        self._stills: list[_Still] = []
        self._quiet_until_ns = 0

    def add_stills(self, instants_ns: Sequence[int], period_ns: int, now_ns: int) -> tuple[int, ...]:
        """Order a picture at each of these instants that the app can take, and return those.

        The trigger goes to half a period before, so that the first frame after it is the nearest one.
        """
        taken: list[int] = []
        for instant_ns in instants_ns:
            before_ns = self._stills[-1].instant_ns if self._stills else None
            trigger_ns = instant_ns - period_ns // 2
            if trigger_ns <= now_ns or (before_ns is not None and instant_ns < before_ns + STILL_EVERY_NS):
                continue
            due_ns = now_ns if before_ns is None else max(now_ns, before_ns + STILL_EVERY_NS // 2)
            self._stills.append(_Still(instant_ns, trigger_ns, due_ns))
            taken.append(instant_ns)
        return tuple(taken)

    def triggers_due(self, now_ns: int) -> list[int]:
        """Return the triggers that are to be sent now, in leader time in ns."""
        due = []
        for still in self._stills:
            if now_ns >= still.due_ns and now_ns < still.trigger_ns:
                due.append(still.trigger_ns)
                still.due_ns = now_ns + AGAIN_EVERY_NS
                if still.due_ns > still.trigger_ns - LAST_CALL_NS:
                    still.due_ns = still.instant_ns
        for still in self._stills:
            if now_ns >= still.instant_ns:
                self._quiet_until_ns = max(self._quiet_until_ns, still.instant_ns + QUIET_AFTER_NS)
        self._stills = [still for still in self._stills if now_ns < still.instant_ns]
        return due

    def may_align(self, now_ns: int) -> bool:
        """Whether no picture or recording is near."""
        if self.is_recording or now_ns < self._quiet_until_ns:
            return False
        return all(still.instant_ns > now_ns + QUIET_BEFORE_NS for still in self._stills)

    def next_timer(self) -> int | None:
        """Leader time in ns at which a trigger is due, None for never."""
        return min((still.due_ns for still in self._stills), default=None)
