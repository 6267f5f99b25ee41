"""A client's side of the reference broadcast: it reports when beacons arrived and corrects its clock."""

from capture_app.sync.clock.time_map import Correction, TimeMap
from capture_app.sync.reference_broadcast.cells import LEAST_COMMON
from capture_app.sync.wire.beacon import AgreedArrival, Arrival, ArrivalReport

_MS = 1_000_000
KEPT_BEACONS = 24
"""Newest beacons that are reported: six seconds at four a second."""
MAX_AGE_NS = 10_000 * _MS
"""Older arrivals and answers do not count: the clock goes back to its own estimate."""
REPORT_EVERY_NS = 1000 * _MS
SLEW = 100e-6
"""How fast a correction changes, in ns per ns: as fast as the greatest skew of a clock."""


class Listener:
    """Beacons heard from one leader; times in ns of the node's own clock unless they say leader."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything: there is another leader, or a clock stepped."""
        self.correction: Correction | None = None
        """None where no answer came, or all are too old."""
        self._arrivals: dict[int, int] = {}
        """By number, the one that came first in front."""
        self._reported_ns: int | None = None
        self._new_arrivals = False
        self._answer: tuple[int, AgreedArrival] | None = None
        """With the local time at which its beacon was heard."""
        self._last: TimeMap | None = None

    def add_arrival(self, number: int, local_ns: int) -> None:
        """Note when a beacon arrived; of copies the first counts."""
        if number in self._arrivals:
            return
        self._arrivals[number] = local_ns
        self._new_arrivals = True
        if len(self._arrivals) > KEPT_BEACONS:
            del self._arrivals[next(iter(self._arrivals))]

    def next_timer(self) -> int | None:
        """When `report_due` wants to be called, None for not before another beacon."""
        if not self._new_arrivals or len(self._arrivals) < LEAST_COMMON:
            return None
        return -(2**62) if self._reported_ns is None else self._reported_ns + REPORT_EVERY_NS

    def report_due(self, client: int, own: TimeMap, now_ns: int) -> ArrivalReport | None:
        """Return the arrivals in leader time by the client's own estimate, None where no report is due.

        That estimate is not corrected: no client shall get its correction back as another's measurement.
        """
        due_ns = self.next_timer()
        if due_ns is None or now_ns < due_ns:
            return None
        self._reported_ns, self._new_arrivals = now_ns, False
        arrivals: list[Arrival] = []
        for number, local_ns in sorted(self._arrivals.items()):
            if 0 <= now_ns - local_ns <= MAX_AGE_NS:
                arrivals.append((number, own.leader_from_local(local_ns)))
            else:
                del self._arrivals[number]
        uncertainty_ns, hard_bound_ns = own.uncertainty_at(now_ns), own.hard_bound_at(now_ns)
        return ArrivalReport(client, round(uncertainty_ns), round(hard_bound_ns), tuple(arrivals))

    def accept(self, answer: AgreedArrival) -> None:
        """Take the leader's answer for a beacon that was heard here; late answers change nothing."""
        local_ns = self._arrivals.get(answer.number)
        if local_ns is not None and (self._answer is None or local_ns >= self._answer[0]):
            self._answer = local_ns, answer

    def correct(self, own: TimeMap, now_ns: int) -> TimeMap:
        """Move an estimate slowly towards the leader's answer, never by more than its hard bound.

        `own` is the newest estimate, at the epoch `now_ns`. Without an answer it is returned as it is.
        """
        answer, goal_ns = self._usable_answer(own, now_ns), 0
        if answer is None and self.correction is None:
            return own
        if answer is not None:
            goal_ns = answer[1].leader_ns - own.leader_from_local(answer[0])
        last = self._last or own
        # From where the clock stood, not from the newest estimate: that one jumps with each better message.
        stood_ns = last.leader_from_local(now_ns) - own.leader_from_local(now_ns)
        step_ns, bound_ns = round(SLEW * max(0, now_ns - last.epoch_local_ns)), int(own.hard_bound_ns)
        correction_ns = stood_ns + min(max(goal_ns - stood_ns, -step_ns), step_ns)
        correction_ns = min(max(correction_ns, -bound_ns), bound_ns)
        if answer is None and correction_ns == 0:
            self.correction = self._last = None
            return own
        uncertainty_ns = relative_uncertainty_ns = own.uncertainty_ns + abs(correction_ns)
        if answer is not None:
            # The skew's error has moved the clock since.
            left_ns = abs(goal_ns - correction_ns) + own.skew_uncertainty * (now_ns - answer[0])
            uncertainty_ns = min(uncertainty_ns, answer[1].uncertainty_ns + left_ns)
            relative_uncertainty_ns = answer[1].relative_uncertainty_ns + left_ns
        self.correction = Correction(correction_ns, relative_uncertainty_ns)
        self._last = own.corrected_by(self.correction, uncertainty_ns)
        return self._last

    def _usable_answer(self, own: TimeMap, now_ns: int) -> tuple[int, AgreedArrival] | None:
        """The answer, unless it is old or the hard bound excludes it."""
        if self._answer is None or not 0 <= now_ns - self._answer[0] <= MAX_AGE_NS:
            return None
        local_ns, answer = self._answer
        wrong_ns = abs(answer.leader_ns - own.leader_from_local(local_ns))
        return self._answer if wrong_ns <= own.hard_bound_at(local_ns) else None
