"""A goal and an instant that suit the cameras which cannot be moved at will.

A restart lands where it likes, and then drifts. So the grid of instants is laid where most of those cameras
will be at some moment to come, and only the others are restarted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from capture_app.sync.phase.goal import Goal

WEIGHTS = {"none": 1000, "reset": 1}
"""How much it counts to suit a camera, by its phase control; those that are not here move to any goal."""
ROUND_NS = 800_000_000
"""About the time that one restart takes."""
LUCK = 3.0
"""How much likelier than a uniform restart one is thought to land in the window, before any was seen."""
AHEAD_S = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 18.0, 25.0, 35.0)
"""Moments to come that are weighed; further ahead, crystals wander."""
LATER = 0.1
"""What it costs to be judged before all have landed, by the time between: some will have drifted away."""
MOST_PPM = 1000.0
"""A camera that drifts faster suits no goal for long."""
MANY = 100
"""More cameras outside than this make no difference any more."""
PATIENCE_NS = 3_000_000_000
"""Nobody is restarted for so long while some of the cameras have not told their first phase."""
KEEP_NS = 3_000_000_000
"""A goal is kept as it is while all cameras will suit it for so long."""


@dataclass(frozen=True, slots=True)
class Standing:
    """What a camera says of itself: a frame's leader time in ns, None while it does not know its phase."""

    name: str
    control: str
    frame_leader_ns: int | None
    drift_ppm: float
    tolerance_ns: int


@dataclass(frozen=True, slots=True)
class Stance:
    """A camera's distance from the goal in ns now, its drift (ns per ns), tolerance in ns, and weight."""

    error_ns: float
    drift: float
    tolerance_ns: int
    weight: int


def time_needed_ns(outside: int, chance: float) -> int:
    """About how long it takes until so many cameras have all landed in the window.

    The expected largest of that many geometric tries: the harmonic number over the chance of one.
    """
    return ceil(sum(1.0 / n for n in range(1, outside + 1)) / chance * ROUND_NS)


def weight_inside(stances: Sequence[Stance], ahead_ns: float, period_ns: int) -> int:
    """Weight of the cameras that will be within their tolerance of the goal so much later."""
    half = period_ns / 2
    return sum(
        s.weight
        for s in stances
        if abs((s.error_ns + s.drift * ahead_ns + half) % period_ns - half) <= s.tolerance_ns
    )


def best_shift(stances: Sequence[Stance], ahead_ns: float, period_ns: int) -> tuple[int, int]:
    """The shift of the goal in ns, in [-period/2, period/2), that suits most so much later, and their weight.

    Each camera is suited by an arc of goals; the answer is the middle of where most weight overlaps, so that
    it lasts for longest. Of several such places it is the widest: there the cameras are closest together,
    and leave most room for those still to come.
    """
    weight = 0
    edges: list[tuple[float, int]] = []
    for s in stances:
        if 2 * s.tolerance_ns >= period_ns:
            weight += s.weight
            continue
        begin = (s.error_ns + s.drift * ahead_ns - s.tolerance_ns) % period_ns
        end = (begin + 2 * s.tolerance_ns) % period_ns
        edges += [(begin, s.weight), (end, -s.weight)]
        weight += s.weight if end < begin else 0
    if not edges:
        return 0, weight
    # Where arcs end as others begin, both count.
    edges.sort(key=lambda edge: (edge[0], -edge[1]))
    best, room, shift = -1, 0.0, 0.0
    for i, (at, change) in enumerate(edges):
        weight += change
        until = edges[i + 1][0] if i + 1 < len(edges) else edges[0][0] + period_ns
        if (weight, until - at) > (best, room):
            best, room, shift = weight, until - at, (at + until) / 2
    return round((shift + period_ns / 2) % period_ns - period_ns / 2), best


class Agreement:
    """The rig's goal, moved to suit the cameras that can only be restarted, and when they are judged."""

    def __init__(self, goal: Goal) -> None:
        self.goal = goal
        self.agreed_leader_ns: int | None = None
        """Cameras should suit the goal at this instant, or be restarted; None where nobody should be."""
        self._began_leader_ns: int | None = None
        self._patient = True
        self._landings = self._hits = 0
        self._in_flight: set[str] = set()

    def update(self, standings: Sequence[Standing], now_leader_ns: int) -> bool:
        """Weigh what all cameras say of themselves; return whether the goal has moved.

        A moment is as good as it is soon: not before all cameras outside of its best window have landed.
        """
        period_ns = self.goal.period_ns
        stances = [s for s in (self._stance(standing, now_leader_ns) for standing in standings) if s]
        unknown = sum(s.control == "reset" and s.frame_leader_ns is None for s in standings)
        everybody = sum(s.weight for s in stances)
        suits_all = unknown == 0 and all(
            weight_inside(stances, ahead_ns, period_ns) == everybody for ahead_ns in (0, KEEP_NS)
        )
        if suits_all or self._is_early(unknown, len(stances), now_leader_ns):
            self.agreed_leader_ns = None
            return False
        chance = self._chance(standings, now_leader_ns)
        candidates = [ahead_s * 1e9 for ahead_s in AHEAD_S]
        if self.agreed_leader_ns is not None and self.agreed_leader_ns > now_leader_ns:
            candidates.insert(0, self.agreed_leader_ns - now_leader_ns)
        least = float("inf")
        best_ahead_ns, best_move_ns = 0.0, 0
        for ahead_ns in candidates:
            shift_ns, weight = best_shift(stances, ahead_ns, period_ns)
            if weight_inside(stances, ahead_ns, period_ns) >= weight:
                shift_ns = 0
            needed_ns = time_needed_ns(unknown + min(everybody - weight, MANY), chance)
            cost = max(ahead_ns, needed_ns) + LATER * max(0.0, needed_ns - ahead_ns)
            if cost < least:
                least, best_ahead_ns, best_move_ns = cost, ahead_ns, shift_ns
        self.agreed_leader_ns = now_leader_ns + round(best_ahead_ns)
        if best_move_ns:
            self.goal = Goal(self.goal.anchor_leader_ns + best_move_ns, period_ns)
        return best_move_ns != 0

    def _is_early(self, unknown: int, known: int, now_leader_ns: int) -> bool:
        """Whether to wait for those that do not know their phase yet: the best of all windows is free."""
        if self._began_leader_ns is None and known:
            self._began_leader_ns = now_leader_ns
        if self._began_leader_ns is None or unknown == 0:
            self._patient = self._patient and unknown > 0
            return not known
        self._patient = self._patient and now_leader_ns < self._began_leader_ns + PATIENCE_NS
        return self._patient

    def _chance(self, standings: Sequence[Standing], now_leader_ns: int) -> float:
        """How likely a restart lands in the window, from the geometry and from those that were seen."""
        agreed_leader_ns = max(now_leader_ns, self.agreed_leader_ns or now_leader_ns)
        uniform = 1.0
        for standing in standings:
            if standing.control != "reset":
                continue
            uniform = min(uniform, 2.0 * standing.tolerance_ns / self.goal.period_ns)
            if standing.frame_leader_ns is None:
                self._in_flight.add(standing.name)
            elif standing.name in self._in_flight:
                self._in_flight.discard(standing.name)
                stance = self._stance(standing, now_leader_ns)
                ahead_ns = agreed_leader_ns - now_leader_ns
                self._landings += 1
                self._hits += weight_inside([stance] if stance else [], ahead_ns, self.goal.period_ns)
        expected = max(1e-6, min(0.9, LUCK * uniform))
        return (self._hits + 1.0) / (self._landings + 1.0 / expected)

    def _stance(self, standing: Standing, now_leader_ns: int) -> Stance | None:
        weight = WEIGHTS.get(standing.control)
        if weight is None or standing.frame_leader_ns is None:
            return None
        if not abs(standing.drift_ppm) < MOST_PPM:
            return None
        drift = standing.drift_ppm * 1e-6
        since_ns = now_leader_ns - standing.frame_leader_ns
        error_ns = self.goal.phase_error(standing.frame_leader_ns) + drift * since_ns
        return Stance(error_ns, drift, standing.tolerance_ns, weight)
