"""A client's side of the reference broadcast: when it heard the beacons, and what came of telling it."""

from capture_app.sync.clock.time_map import Correction, TimeMap
from capture_app.sync.reference_broadcast.reference import LEAST_COMMON
from capture_app.sync.wire.beacon import AgreedArrival, Arrival, ArrivalReport

_MS = 1_000_000
KEPT = 24
"""Newest beacons that are told of: six seconds at four a second."""
FADES_NS = 10_000 * _MS
"""Arrivals and agreements older than this count no more: the clock's own estimate is believed again."""
TELL_EVERY_NS = 1000 * _MS
SLEW = 100e-6
"""How fast a clock is moved, in ns per ns: as fast as the skews that it is prepared for."""


class Listener:
    """Beacons heard from one leader; times in ns of the node's own clock unless they say leader."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Another leader, or a clock that stepped: nothing of it holds any more."""
        self.correction: Correction | None = None
        """None where nothing was agreed, or it has faded."""
        self._arrivals: dict[int, int] = {}
        """By number, the one that came first in front."""
        self._told_ns: int | None = None
        self._news = False
        self._agreed: tuple[int, AgreedArrival] | None = None
        """With the local time at which its beacon was heard."""
        self._last: TimeMap | None = None

    def hear(self, number: int, local_ns: int) -> None:
        """Note when a beacon came; of copies the first counts."""
        if number in self._arrivals:
            return
        self._arrivals[number] = local_ns
        self._news = True
        if len(self._arrivals) > KEPT:
            del self._arrivals[next(iter(self._arrivals))]

    def next_timer(self) -> int | None:
        """When `tell` wants to be called, None for not before another beacon."""
        if not self._news or len(self._arrivals) < LEAST_COMMON:
            return None
        return -(2**62) if self._told_ns is None else self._told_ns + TELL_EVERY_NS

    def tell(self, client: int, own: TimeMap, now_ns: int) -> ArrivalReport | None:
        """Return what was heard, by the client's own estimate of the leader's clock, None where none is due.

        Its own, uncorrected: nobody's correction comes back to him as another's opinion.
        """
        due_ns = self.next_timer()
        if due_ns is None or now_ns < due_ns:
            return None
        self._told_ns, self._news = now_ns, False
        arrivals: list[Arrival] = []
        for number, local_ns in sorted(self._arrivals.items()):
            if 0 <= now_ns - local_ns <= FADES_NS:
                arrivals.append((number, own.leader_from_local(local_ns)))
            else:
                del self._arrivals[number]
        uncertainty_ns, hard_bound_ns = own.uncertainty_at(now_ns), own.hard_bound_at(now_ns)
        return ArrivalReport(client, round(uncertainty_ns), round(hard_bound_ns), tuple(arrivals))

    def take(self, agreed: AgreedArrival) -> None:
        """Note what was agreed on a beacon that was heard here; late answers change nothing."""
        local_ns = self._arrivals.get(agreed.number)
        if local_ns is not None and (self._agreed is None or local_ns >= self._agreed[0]):
            self._agreed = local_ns, agreed

    def corrected(self, own: TimeMap, now_ns: int) -> TimeMap:
        """Move an estimate towards what was agreed, slowly, and never by more than its hard bound.

        `own` is the newest estimate, at the epoch `now_ns`. Without an agreement it is returned as it is.
        """
        agreed, goal_ns = self._believed(own, now_ns), 0
        if agreed is None and self.correction is None:
            return own
        if agreed is not None:
            goal_ns = agreed[1].leader_ns - own.leader_from_local(agreed[0])
        last = self._last or own
        # From where the clock stood, not from the newest estimate: that one jumps when a message was lucky.
        stood_ns = last.leader_from_local(now_ns) - own.leader_from_local(now_ns)
        step_ns, bound_ns = round(SLEW * max(0, now_ns - last.epoch_local_ns)), int(own.hard_bound_ns)
        correction_ns = stood_ns + min(max(goal_ns - stood_ns, -step_ns), step_ns)
        correction_ns = min(max(correction_ns, -bound_ns), bound_ns)
        if agreed is None and correction_ns == 0:
            self.correction = self._last = None
            return own
        uncertainty_ns = relative_uncertainty_ns = own.uncertainty_ns + abs(correction_ns)
        if agreed is not None:
            # What is wrong in the skew has moved the clock since.
            left_ns = abs(goal_ns - correction_ns) + own.skew_uncertainty * (now_ns - agreed[0])
            uncertainty_ns = min(uncertainty_ns, agreed[1].uncertainty_ns + left_ns)
            relative_uncertainty_ns = agreed[1].relative_uncertainty_ns + left_ns
        self.correction = Correction(correction_ns, relative_uncertainty_ns)
        self._last = own.corrected_by(self.correction, uncertainty_ns)
        return self._last

    def _believed(self, own: TimeMap, now_ns: int) -> tuple[int, AgreedArrival] | None:
        """What was agreed, unless it is old or the messages prove that it cannot be."""
        if self._agreed is None or not 0 <= now_ns - self._agreed[0] <= FADES_NS:
            return None
        local_ns, agreed = self._agreed
        wrong_ns = abs(agreed.leader_ns - own.leader_from_local(local_ns))
        return self._agreed if wrong_ns <= own.hard_bound_at(local_ns) else None
