"""Choice of the grid's phase to suit the cameras whose phase cannot be moved at will.

A restart sets a random phase, which then drifts. The grid is therefore placed where most of those cameras
will be at some future instant, and only the others are restarted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from capture_app.common.camera_facts import PhaseControl
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.phase.period_choice import MAX_DRIFT_PPM

WEIGHTS = {PhaseControl.NONE: 1000, PhaseControl.RESET: 1}
"""Weight of a camera in the choice, by its phase control; other cameras can move to any grid."""
RESTART_NS = 800_000_000
"""Approximate duration of one restart."""
PRIOR_GAIN = 3.0
"""Probability of landing in the window, relative to a uniform restart, assumed before any was observed."""
AHEAD_S = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 18.0, 25.0, 35.0)
"""Times ahead at which a common instant is considered; further ahead, crystals drift unpredictably."""
EARLY_COST = 0.1
"""Cost of an instant before all restarts are done, as a fraction of the missing time: some drift away."""
MAX_OUTSIDE = 100
"""Maximum number of cameras outside their tolerance that is distinguished."""
START_TIMEOUT_NS = 3_000_000_000
"""Timeout before the first restart while the phase of some cameras is unknown."""
KEEP_NS = 3_000_000_000
"""Time for which all cameras must stay within their tolerance for the grid to be kept."""


@dataclass(frozen=True, slots=True)
class CameraPhase:
    """Reported phase of a camera: the leader time in ns of a frame, None while its phase is unknown."""

    name: str
    phase_control: PhaseControl
    frame_leader_ns: int | None
    drift_ppm: float
    tolerance_ns: int


@dataclass(frozen=True, slots=True)
class WeightedDrift:
    """Distance of a camera from the grid in ns, with drift (ns per ns), tolerance in ns, and weight."""

    error_ns: float
    rate: float
    tolerance_ns: int
    weight: int


def weight_inside(drifts: Sequence[WeightedDrift], ahead_ns: float, period_ns: int) -> int:
    """Return the total weight of the cameras that will be within tolerance of the grid in `ahead_ns`."""
    half = period_ns / 2
    return sum(
        drift.weight
        for drift in drifts
        if abs((drift.error_ns + drift.rate * ahead_ns + half) % period_ns - half) <= drift.tolerance_ns
    )


def best_shift(drifts: Sequence[WeightedDrift], ahead_ns: float, period_ns: int) -> tuple[int, int]:
    """Return the grid shift in ns, in [-period/2, period/2), that suits most weight in `ahead_ns`.

    Also returns that weight. Each camera is suited by an arc of grids. The result is the middle of the arc
    where most weight overlaps, so that it lasts longest. Of several such arcs the widest is used: there the
    cameras are closest together, which leaves most room for cameras still to come.
    """
    weight = 0
    edges: list[tuple[float, int]] = []
    for drift in drifts:
        if 2 * drift.tolerance_ns >= period_ns:
            weight += drift.weight
            continue
        begin = (drift.error_ns + drift.rate * ahead_ns - drift.tolerance_ns) % period_ns
        end = (begin + 2 * drift.tolerance_ns) % period_ns
        edges += [(begin, drift.weight), (end, -drift.weight)]
        weight += drift.weight if end < begin else 0
    if not edges:
        return 0, weight
    # Where one arc ends as another begins, both count.
    edges.sort(key=lambda edge: (edge[0], -edge[1]))
    best, room, shift = -1, 0.0, 0.0
    for i, (at, change) in enumerate(edges):
        weight += change
        until = edges[i + 1][0] if i + 1 < len(edges) else edges[0][0] + period_ns
        if (weight, until - at) > (best, room):
            best, room, shift = weight, until - at, (at + until) / 2
    return round((shift + period_ns / 2) % period_ns - period_ns / 2), best


class GridPhaseChoice:
    """Grid of a rig, moved to suit the cameras that can only be restarted, and the instant to meet it."""

    def __init__(self, grid: FrameGrid) -> None:
        self.grid = grid
        self.common_instant_leader_ns: int | None = None
        """Cameras that will be off the grid at this instant are restarted; if None, no camera is."""
        self._began_leader_ns: int | None = None
        self._patient = True
        self._landings = self._hits = 0
        self._in_flight: set[str] = set()

    def update(self, cameras: Sequence[CameraPhase], now_leader_ns: int) -> bool:
        """Choose grid and common instant from the phases of all cameras. Return whether the grid moved.

        The cost of an instant is the time until then, or until all cameras outside its best window are
        expected to have landed in it.
        """
        period_ns = self.grid.period_ns
        drifts = [c for c in (self._drift(camera, now_leader_ns) for camera in cameras) if c]
        unknown = sum(
            camera.phase_control == PhaseControl.RESET and camera.frame_leader_ns is None
            for camera in cameras
        )
        total_weight = sum(drift.weight for drift in drifts)
        suits_all = unknown == 0 and all(
            weight_inside(drifts, ahead_ns, period_ns) == total_weight for ahead_ns in (0, KEEP_NS)
        )
        if suits_all or self._is_early(unknown, len(drifts), now_leader_ns):
            self.common_instant_leader_ns = None
            return False
        chance = self._chance(cameras, now_leader_ns)
        candidates = [ahead_s * 1e9 for ahead_s in AHEAD_S]
        if self.common_instant_leader_ns is not None and self.common_instant_leader_ns > now_leader_ns:
            candidates.insert(0, self.common_instant_leader_ns - now_leader_ns)
        min_cost = float("inf")
        best_ahead_ns, best_move_ns = 0.0, 0
        for ahead_ns in candidates:
            shift_ns, weight = best_shift(drifts, ahead_ns, period_ns)
            if weight_inside(drifts, ahead_ns, period_ns) >= weight:
                shift_ns = 0
            outside = unknown + min(total_weight - weight, MAX_OUTSIDE)
            # Expected maximum of `outside` geometric tries: the harmonic number over the probability of one.
            needed_ns = ceil(sum(1.0 / n for n in range(1, outside + 1)) / chance * RESTART_NS)
            cost = max(ahead_ns, needed_ns) + EARLY_COST * max(0.0, needed_ns - ahead_ns)
            if cost < min_cost:
                min_cost, best_ahead_ns, best_move_ns = cost, ahead_ns, shift_ns
        self.common_instant_leader_ns = now_leader_ns + round(best_ahead_ns)
        if best_move_ns:
            self.grid = FrameGrid(self.grid.anchor_leader_ns + best_move_ns, period_ns)
        return best_move_ns != 0

    def _is_early(self, unknown: int, known: int, now_leader_ns: int) -> bool:
        """Whether to wait before choosing: cameras of unknown phase may still change the best window."""
        if self._began_leader_ns is None and known:
            self._began_leader_ns = now_leader_ns
        if self._began_leader_ns is None or unknown == 0:
            self._patient = self._patient and unknown > 0
            return not known
        self._patient = self._patient and now_leader_ns < self._began_leader_ns + START_TIMEOUT_NS
        return self._patient

    def _chance(self, cameras: Sequence[CameraPhase], now_leader_ns: int) -> float:
        """Return the probability that a restart lands in the window, from its size and past restarts."""
        common_instant_leader_ns = max(now_leader_ns, self.common_instant_leader_ns or now_leader_ns)
        uniform = 1.0
        for camera in cameras:
            if camera.phase_control != PhaseControl.RESET:
                continue
            uniform = min(uniform, 2.0 * camera.tolerance_ns / self.grid.period_ns)
            if camera.frame_leader_ns is None:
                self._in_flight.add(camera.name)
            elif camera.name in self._in_flight:
                self._in_flight.discard(camera.name)
                drift = self._drift(camera, now_leader_ns)
                ahead_ns = common_instant_leader_ns - now_leader_ns
                self._landings += 1
                self._hits += weight_inside([drift] if drift else [], ahead_ns, self.grid.period_ns)
        expected = max(1e-6, min(0.9, PRIOR_GAIN * uniform))
        return (self._hits + 1.0) / (self._landings + 1.0 / expected)

    def _drift(self, camera: CameraPhase, now_leader_ns: int) -> WeightedDrift | None:
        weight = WEIGHTS.get(camera.phase_control)
        if weight is None or camera.frame_leader_ns is None:
            return None
        if not abs(camera.drift_ppm) < MAX_DRIFT_PPM:
            return None
        drift = camera.drift_ppm * 1e-6
        since_ns = now_leader_ns - camera.frame_leader_ns
        error_ns = self.grid.phase_error(camera.frame_leader_ns) + drift * since_ns
        return WeightedDrift(error_ns, drift, camera.tolerance_ns, weight)
