"""Single trials of the experiment `phase`: our engine aligns one camera, or a group."""

import heapq
import random
from dataclasses import dataclass, field, replace

from benchmarks.simulated.aligner_bench import Bench
from capture_app.common.camera_facts import PhaseControl
from capture_app.plugins.cameras.sim.profiles import PROFILES, SensorProfile
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.actuators import InjectionProfile
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.phase.grid_phase_choice import CameraPhase, GridPhaseChoice

S = 1_000_000_000
PAPERS_SLEEP_NS = S
"""Maximum sleep of the paper's method: U(0, 1 s) before each start; with one frame, 1.23 s in total."""
ALONE_S, TOGETHER_S, PAPERS_S = 300, 600, 5000
"""Timeouts: one camera, a group, a group by the paper's method."""
PPM = 20.0
"""Maximum crystal error of cameras that restart."""
LIB_OVERHEAD_NS = 200_000
LIB_LEAST_NS = 50_000
LIB_WAIT_NS = 400_000_000
LIB_MOST = 50
"""Injections at which we stop counting; the three above are libsoftwaresync's constants and its pause."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """Cost of an alignment: injections or restarts, and seconds from the first of them; None for never."""

    moves: int
    seconds: float | None


@dataclass(slots=True)
class Attempts:
    """Costs of all trials, by device and method."""

    injections: dict[str, dict[str, list[Attempt]]] = field(default_factory=dict)
    restarts: dict[str, dict[str, list[Attempt]]] = field(default_factory=dict)


def inject_like_libsoftwaresync(profile: SensorProfile, seed: int, tolerance_ns: int) -> Attempt:
    """Align by the paper's published code: exposure = T + d/2 - overhead, again and again."""
    rng = random.Random(seed)
    period_ns, drift = profile.period_ns, rng.gauss(0.0, 15e-6)
    error_ns = rng.uniform(-period_ns / 2, period_ns / 2)
    for moves in range(LIB_MOST + 1):
        if abs(error_ns + rng.gauss(0.0, profile.timestamp_noise_ns)) <= tolerance_ns:
            return Attempt(moves, moves * LIB_WAIT_NS / S)
        later_ns = -error_ns % period_ns
        exposure_ns = max(period_ns + LIB_LEAST_NS, period_ns + later_ns / 2 - LIB_OVERHEAD_NS)
        shift_ns = sum(profile.stretches_rows(round(exposure_ns))) * profile.row_time_ns
        error_ns += shift_ns + drift * LIB_WAIT_NS
        error_ns = (error_ns + period_ns / 2) % period_ns - period_ns / 2
    return Attempt(LIB_MOST, None)


def uniform_ppm(rng: random.Random) -> float:
    """Return the error of a crystal, at most PPM."""
    return rng.uniform(-PPM, PPM)


def restart_like_the_paper(
    profile: SensorProfile,
    count: int,
    seed: int,
    tolerance_ns: int,
) -> Attempt:
    """Align by restarts as in the paper: each camera alone, against one grid, until all are in at once.

    A model of restarts and drift without frames: a camera that drifts out of the tolerance is restarted.
    """
    rng = random.Random(seed)
    period_ns = profile.period_ns
    drifts = [uniform_ppm(rng) * 1e-6 for _ in range(count)]
    since_ns = [0.0] * count
    phases_ns = [rng.uniform(-period_ns / 2, period_ns / 2) for _ in range(count)]
    mean_ns, sd_ns = profile.start_latency_ns
    moves, now_ns = 0, 0.0
    due: list[tuple[float, int]] = [(0.0, camera) for camera in range(count)]

    def inside_until(camera: int) -> float:
        """Return when that camera leaves the tolerance; before now if it is already outside."""
        error_ns = phases_ns[camera] + drifts[camera] * (now_ns - since_ns[camera])
        if abs(error_ns) > tolerance_ns:
            return now_ns - 1.0
        drift = drifts[camera]
        room_ns = tolerance_ns - error_ns if drift > 0 else tolerance_ns + error_ns
        return now_ns + room_ns / max(abs(drift), 1e-12)

    landed = [False] * count
    while due and now_ns < PAPERS_S * S:
        now_ns, camera = heapq.heappop(due)
        landed[camera] = True
        leaves_ns = inside_until(camera)
        if leaves_ns < now_ns:
            latency_ns = max(0.0, rng.gauss(mean_ns, sd_ns))
            lands_ns = now_ns + rng.random() * PAPERS_SLEEP_NS + latency_ns + period_ns
            landed[camera] = False
            since_ns[camera], phases_ns[camera] = lands_ns, rng.uniform(-period_ns / 2, period_ns / 2)
            moves += 1
            heapq.heappush(due, (lands_ns, camera))
            continue
        if all(landed) and all(inside_until(other) >= now_ns for other in range(count)):
            return Attempt(moves, now_ns / S)
        heapq.heappush(due, (leaves_ns + 1.0, camera))
    return Attempt(moves, None)


EXACT = TimeMap(0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 300, 1000)
REPORT_NS = 500_000_000
"""Interval at which a camera that knows its phase reports it."""


def unknown_phone(rng: random.Random) -> SensorProfile:
    """Return a phone with known row time, but unknown frame latency and overhead."""
    row_ns = rng.choice((8_000, 10_840, 12_300, 15_000))
    return replace(
        PROFILES["phone-a"],
        row_time_ns=row_ns,
        frame_length_rows=round(33_333_000 / row_ns),
        margin_rows=rng.randint(2, 60),
        injection_gain=rng.choice((1, 2, 3)),
    )


def known_profile(profile: SensorProfile) -> InjectionProfile:
    """Return the profile stored on disk after a device of that model was used."""
    return InjectionProfile(profile.row_time_ns, profile.injection_gain, float(profile.neutral_rows))


def align_one_camera(
    profile: SensorProfile,
    seed: int,
    tolerance_ns: int,
    *,
    row_known: bool = True,
    aimed: bool = True,
    known: InjectionProfile | None = None,
) -> Attempt:
    """Bring one camera within the tolerance with our engine, from any phase."""
    bench = Bench(profile, seed, tolerance_ns, row_known=row_known, aimed=aimed, known=known)
    begun = bench.run(30 * S, until=lambda _: bool(bench.commands) or bench.aligner.window.aligned)
    from_ns = begun[-1].now_ns
    if not bench.aligner.window.aligned:
        looks = bench.run(ALONE_S * S, until=lambda look: look.aligned)
        if not looks or not looks[-1].aligned:
            return Attempt(bench.aligner.corrections, None)
        return Attempt(bench.aligner.corrections, (looks[-1].now_ns - from_ns) / S)
    return Attempt(0, 0.0)


def restart_together(
    profile: SensorProfile,
    count: int,
    seed: int,
    tolerance_ns: int,
    *,
    aimed: bool,
) -> Attempt:
    """Align restart-only cameras with our engine: a shared grid and a common instant, until all are aligned.

    Uses the engine's aligners and shared grid on simulated sensors, with perfect clocks and network. Seconds
    count from the moment that all cameras know their phase.
    """
    rng = random.Random(seed)
    grid_choice = GridPhaseChoice(FrameGrid(0, profile.period_ns))
    benches = [
        Bench(
            profile,
            rng.getrandbits(32),
            tolerance_ns,
            ppm=uniform_ppm(rng),
            aimed=aimed,
            grid=grid_choice.grid,
        )
        for _ in range(count)
    ]
    told_ns = [0] * count
    camera_phases = [_unknown_phase(number, tolerance_ns) for number in range(count)]
    heap = [(bench.due_ns, number) for number, bench in enumerate(benches)]
    heapq.heapify(heap)
    began_ns: int | None = None
    while heap[0][0] < TOGETHER_S * S:
        now_ns, number = heapq.heappop(heap)
        bench = benches[number]
        frame = bench.next_frame()
        if not frame.dropped:
            bench.aligner.complete_command(now_ns)
            if not bench.aligner.settled:
                camera_phases[number] = _unknown_phase(number, tolerance_ns)
            elif camera_phases[number].frame_leader_ns is None or now_ns - told_ns[number] >= REPORT_NS:
                told_ns[number] = now_ns
                camera_phases[number] = _camera_phase(number, bench, grid_choice.grid, tolerance_ns)
                grid_choice.update(camera_phases, now_ns)
            if began_ns is None and all(s.frame_leader_ns is not None for s in camera_phases):
                began_ns = now_ns
            bench.grid, bench.common_instant_leader_ns = (
                grid_choice.grid,
                grid_choice.common_instant_leader_ns,
            )
            before = len(bench.commands)
            bench.step_aligner(frame, hold=bench.common_instant_leader_ns is None)
            if len(bench.commands) > before:
                camera_phases[number] = _unknown_phase(number, tolerance_ns)
            if began_ns is not None and all(
                b.aligner.window.aligned and b.grid == grid_choice.grid for b in benches
            ):
                return Attempt(sum(len(b.commands) for b in benches), (now_ns - began_ns) / S)
        heapq.heappush(heap, (bench.due_ns, number))
    return Attempt(sum(len(b.commands) for b in benches), None)


def _unknown_phase(number: int, tolerance_ns: int) -> CameraPhase:
    return CameraPhase(str(number), PhaseControl.RESET, None, 0.0, tolerance_ns, str(number))


def _camera_phase(number: int, bench: Bench, grid: FrameGrid, tolerance_ns: int) -> CameraPhase:
    estimate = bench.aligner.estimate(EXACT, grid, bench.now_ns) if bench.aligner.settled else None
    if estimate is None:
        return _unknown_phase(number, tolerance_ns)
    frame_ns = grid.instant(grid.index_of(bench.now_ns)) + estimate.error_ns
    return CameraPhase(
        str(number), PhaseControl.RESET, frame_ns, estimate.drift_ppm, tolerance_ns, str(number)
    )
