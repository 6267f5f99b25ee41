"""Choice of the grid's phase to suit the cameras whose phase cannot be moved at will.

A restart sets a random phase, which then drifts. The grid is therefore placed where most of those cameras
will be at some future instant, and only the others are restarted. Each machine has one vote, however many
cameras it has. A camera whose reported phase jumps without a restart has none for a while, nor has its
machine.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from capture_app.common.camera_facts import PhaseControl
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.phase.period_choice import MAX_DRIFT_PPM

MAX_WEIGHT = 1000
"""Weight of a camera that cannot move: more than all the restarts of a rig, so that no number of them
outweighs one camera that only the grid can meet."""
WEIGHTS = {PhaseControl.NONE: MAX_WEIGHT, PhaseControl.RESET: 1}
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
FREE_MOVES, MOVE_INTERVAL_NS = 16, 30_000_000_000
"""Moves of the grid until it moves rarely, if the rig is not ready before; and the interval from then on."""
MIN_JUMP_NS, SLACK_PPM, MAX_JUMP_PERIODS = 2_000_000, 50.0, 0.25
"""Difference between two reported phases that contradict each other: more than the camera's tolerance, at
least MIN_JUMP_NS, plus the error of the reported drift in the time between, but at most a fraction of the
period."""
TRIAL_NS, MAX_DOUBLINGS, FORGIVE_NS, MAX_SUSPENDED = 10_000_000_000, 6, 600_000_000_000, 1000
"""Time without contradiction before the vote of a camera counts that joins a rig that is ready, or of a
machine that has contradicted itself; doublings of it by repetition; time after which that is forgotten;
machines remembered."""


@dataclass(frozen=True, slots=True)
class CameraPhase:
    """Reported phase of a camera: the leader time in ns of a frame, None while its phase is unknown."""

    name: str
    phase_control: PhaseControl
    frame_leader_ns: int | None
    drift_ppm: float
    tolerance_ns: int
    machine: str
    """Machine that votes for it; on an open rig the camera itself."""


@dataclass(frozen=True, slots=True)
class WeightedDrift:
    """Distance of a camera from the grid in ns, with drift (ns per ns), tolerance in ns, and weight."""

    error_ns: float
    rate: float
    tolerance_ns: int
    weight: int
    machine: str


class Support:
    """Support of a grid: one vote per machine with a camera inside its tolerance, and then all cameras."""

    __slots__ = ("_by_machine", "votes", "weight")

    def __init__(self) -> None:
        self.votes = self.weight = 0
        """Sum of the weightiest cameras inside of each machine, and of all cameras inside."""
        self._by_machine: Counter[str] = Counter()

    def add(self, drift: WeightedDrift, sign: int = 1) -> None:
        """Count a camera as inside, or with `sign` -1 no longer."""
        before = self._by_machine[drift.machine]
        self._by_machine[drift.machine] = after = before + sign * drift.weight
        self.votes += _vote(after) - _vote(before)
        self.weight += sign * drift.weight


def _vote(weight: int) -> int:
    return MAX_WEIGHT if weight >= MAX_WEIGHT else min(weight, 1)


def support_now(drifts: Sequence[WeightedDrift], ahead_ns: float, period_ns: int) -> tuple[int, int]:
    """Return the votes and weight of the cameras that will be within tolerance of the grid in `ahead_ns`."""
    half, inside = period_ns / 2, Support()
    for drift in drifts:
        if abs((drift.error_ns + drift.rate * ahead_ns + half) % period_ns - half) <= drift.tolerance_ns:
            inside.add(drift)
    return inside.votes, inside.weight


def best_shift(
    drifts: Sequence[WeightedDrift], ahead_ns: float, period_ns: int
) -> tuple[int, tuple[int, int]]:
    """Return the grid shift in ns, in [-period/2, period/2), that has most support in `ahead_ns`.

    Also returns its votes and weight. Each camera is suited by an arc of grids. The result is the middle of
    the arc with most support, so that it lasts longest. Of several such arcs the widest is used: there the
    cameras are closest together, which leaves most room for cameras still to come.
    """
    inside = Support()
    edges: list[tuple[float, int, WeightedDrift]] = []
    for drift in drifts:
        if 2 * drift.tolerance_ns >= period_ns:
            inside.add(drift)
            continue
        begin = (drift.error_ns + drift.rate * ahead_ns - drift.tolerance_ns) % period_ns
        end = (begin + 2 * drift.tolerance_ns) % period_ns
        edges += [(begin, 1, drift), (end, -1, drift)]
        if end < begin:
            inside.add(drift)
    if not edges:
        return 0, (inside.votes, inside.weight)
    # Where one arc ends as another begins, both count.
    edges.sort(key=lambda edge: (edge[0], -edge[1]))
    best, room, shift = (-1, -1), 0.0, 0.0
    for i, (at, sign, drift) in enumerate(edges):
        inside.add(drift, sign)
        until = edges[i + 1][0] if i + 1 < len(edges) else edges[0][0] + period_ns
        if (inside.votes, inside.weight, until - at) > (*best, room):
            best, room, shift = (inside.votes, inside.weight), until - at, (at + until) / 2
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
        self._known: dict[str, tuple[CameraPhase, int]] = {}
        """Last known phase of each camera, and the time from which its vote counts."""
        self._suspended: dict[str, tuple[int, int]] = {}
        """Contradictions of each machine, and the time until which its cameras have no vote."""
        self.jumps_ns: dict[str, float] = {}
        """Size of the last jump of each camera that has no vote because of it."""
        self._moves = 0
        self._move_due_ns: int | None = None

    def update(
        self, cameras: Sequence[CameraPhase], now_leader_ns: int, is_ready: bool | None = None
    ) -> bool:
        """Choose grid and common instant from the phases of all cameras. Return whether the grid moved.

        The cost of an instant is the time until then, or until all cameras outside its best window are
        expected to have landed in it. The grid of a rig that `is_ready` moves rarely; None: no two machines
        have cameras that its moves disturb.
        """
        period_ns = self.grid.period_ns
        cameras = self._voters(cameras, now_leader_ns, TRIAL_NS if is_ready else 0)
        may_move = self._move_due_ns is None or now_leader_ns >= self._move_due_ns
        drifts = [c for c in (self._drift(camera, now_leader_ns) for camera in cameras) if c]
        unknown = sum(
            camera.phase_control == PhaseControl.RESET and camera.frame_leader_ns is None
            for camera in cameras
        )
        total_weight = sum(drift.weight for drift in drifts)
        suits_all = unknown == 0 and all(
            support_now(drifts, ahead_ns, period_ns)[1] == total_weight for ahead_ns in (0, KEEP_NS)
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
            shift_ns, support = best_shift(drifts, ahead_ns, period_ns)
            here = support_now(drifts, ahead_ns, period_ns)
            if here >= support or not may_move:
                shift_ns, support = 0, here
            outside = unknown + min(total_weight - support[1], MAX_OUTSIDE)
            # Expected maximum of `outside` geometric tries: the harmonic number over the probability of one.
            needed_ns = ceil(sum(1.0 / n for n in range(1, outside + 1)) / chance * RESTART_NS)
            cost = max(ahead_ns, needed_ns) + EARLY_COST * max(0.0, needed_ns - ahead_ns)
            if cost < min_cost:
                min_cost, best_ahead_ns, best_move_ns = cost, ahead_ns, shift_ns
        self.common_instant_leader_ns = now_leader_ns + round(best_ahead_ns)
        if best_move_ns:
            self.grid = FrameGrid(self.grid.anchor_leader_ns + best_move_ns, period_ns)
            self._moves += 1
            if is_ready or (is_ready is not None and self._moves >= FREE_MOVES):
                self._move_due_ns = now_leader_ns + MOVE_INTERVAL_NS
        return best_move_ns != 0

    def _voters(self, cameras: Sequence[CameraPhase], now_ns: int, trial_ns: int) -> list[CameraPhase]:
        """Return the cameras whose votes count, after a look for contradictions in their reports.

        A new camera's vote counts after `trial_ns`.
        """
        known: dict[str, tuple[CameraPhase, int]] = {}
        voters: list[CameraPhase] = []
        for camera in cameras:
            last, counts_ns = self._known.get(camera.name, (camera, now_ns + trial_ns))
            if jump_ns := self._jump_ns(last, camera, now_ns):
                self._suspend(camera.machine, now_ns)
                self.jumps_ns[camera.name] = jump_ns
            # A jump is noticed even where no phase is reported in between.
            known[camera.name] = (last if camera.frame_leader_ns is None else camera), counts_ns
        for camera in cameras:
            _, until_ns = self._suspended.get(camera.machine, (0, now_ns))
            if now_ns >= max(until_ns, known[camera.name][1]):
                voters.append(camera)
                self.jumps_ns.pop(camera.name, None)
        self._known = known
        self.jumps_ns = {name: jump_ns for name, jump_ns in self.jumps_ns.items() if name in known}
        return voters

    def _suspend(self, machine: str, now_ns: int) -> None:
        times, until_ns = self._suspended.pop(machine, (0, now_ns))
        times = 0 if now_ns - until_ns > FORGIVE_NS else times
        if len(self._suspended) >= MAX_SUSPENDED:
            del self._suspended[next(iter(self._suspended))]
        self._suspended[machine] = times + 1, now_ns + TRIAL_NS * 2 ** min(times, MAX_DOUBLINGS)

    def _jump_ns(self, last: CameraPhase, camera: CameraPhase, now_ns: int) -> float:
        """Return by how much a camera's phase contradicts the last one; 0 if it does not, or may restart."""
        before, after, period_ns = self._drift(last, now_ns), self._drift(camera, now_ns), self.grid.period_ns
        if before is None or after is None or last.frame_leader_ns is None or camera.frame_leader_ns is None:
            return 0.0
        ahead_ns = max(0, (self.common_instant_leader_ns or now_ns) - now_ns)
        was_inside = all(support_now([before], at_ns, period_ns)[1] for at_ns in (0, ahead_ns))
        may_restart = not was_inside and camera.name not in self.jumps_ns
        if camera.phase_control is PhaseControl.RESET and may_restart:
            return 0.0
        jump_ns = abs((after.error_ns - before.error_ns + period_ns / 2) % period_ns - period_ns / 2)
        since_ns = abs(camera.frame_leader_ns - last.frame_leader_ns)
        limit_ns = max(last.tolerance_ns, MIN_JUMP_NS) + SLACK_PPM * 1e-6 * since_ns
        return jump_ns if jump_ns > min(limit_ns, MAX_JUMP_PERIODS * period_ns) else 0.0

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
                self._hits += support_now([drift] if drift else [], ahead_ns, self.grid.period_ns)[1]
        expected = max(1e-6, min(0.9, PRIOR_GAIN * uniform))
        return (self._hits + 1.0) / (self._landings + 1.0 / expected)

    def _drift(self, camera: CameraPhase, now_leader_ns: int) -> WeightedDrift | None:
        weight, frame_ns = WEIGHTS.get(camera.phase_control), camera.frame_leader_ns
        if weight is None or frame_ns is None or not abs(camera.drift_ppm) < MAX_DRIFT_PPM:
            return None
        drift = camera.drift_ppm * 1e-6
        error_ns = self.grid.phase_error(frame_ns) + drift * (now_leader_ns - frame_ns)
        return WeightedDrift(error_ns, drift, camera.tolerance_ns, weight, camera.machine)
