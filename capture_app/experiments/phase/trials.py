"""Single trials of the experiment `phase`: a camera, or a group, brought into phase by our engine."""

import heapq
import random
from dataclasses import replace

from capture_app.experiments.phase.baselines import Attempt, S, uniform_ppm
from capture_app.simulation.bench import Bench
from capture_app.simulation.profiles import PROFILES, SensorProfile
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.goal import Goal
from capture_app.sync.phase.injection import InjectionProfile
from capture_app.sync.phase.shared_goal import CameraPhase, SharedGoal

EXACT = TimeMap(0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 300, 1000)
REPORT_NS = 500_000_000
"""A camera that knows its phase reports it again after so long."""


def unknown_phone(rng: random.Random) -> SensorProfile:
    """A phone whose row time is known, but neither how long it holds a frame nor its overhead."""
    row_ns = rng.choice((8_000, 10_840, 12_300, 15_000))
    return replace(
        PROFILES["phone-a"],
        row_time_ns=row_ns,
        frame_length_rows=round(33_333_000 / row_ns),
        margin_rows=rng.randint(2, 60),
        injection_gain=rng.choice((1, 2, 3)),
    )


def known_profile(profile: SensorProfile) -> InjectionProfile:
    """What is kept on disk of a device of that model once it was used."""
    return InjectionProfile(profile.row_time_ns, profile.injection_gain, float(profile.neutral_rows))


def align_one_camera(
    profile: SensorProfile,
    seed: int,
    tolerance_ns: int,
    *,
    row_known: bool = True,
    aimed: bool = True,
    known: InjectionProfile | None = None,
    limit_s: int = 300,
) -> Attempt:
    """Bring one camera within the tolerance with our engine, from any phase."""
    bench = Bench(profile, seed, tolerance_ns, row_known=row_known, aimed=aimed, known=known)
    begun = bench.run(30 * S, until=lambda _: bool(bench.commands) or bench.aligner.aligned)
    from_ns = begun[-1].now_ns
    if not bench.aligner.aligned:
        looks = bench.run(limit_s * S, until=lambda look: look.aligned)
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
    starts_known: int = 0,
    limit_s: float = 600.0,
) -> Attempt:
    """Our way: cameras that can only restart get a shared goal and a meeting instant, until all are aligned.

    The engine's aligners and shared goal on simulated sensors, with perfect clocks and network. Seconds
    count from the moment that all cameras know their phase. `starts_known` start latencies were seen before.
    """
    rng = random.Random(seed)
    shared_goal = SharedGoal(Goal(0, profile.period_ns))
    benches = [
        Bench(
            profile,
            rng.getrandbits(32),
            tolerance_ns,
            ppm=uniform_ppm(rng),
            aimed=aimed,
            goal=shared_goal.goal,
            start_latencies_ns=[round(rng.gauss(*profile.start_latency_ns)) for _ in range(starts_known)],
        )
        for _ in range(count)
    ]
    told_ns = [0] * count
    camera_phases = [_unknown_phase(number, tolerance_ns) for number in range(count)]
    heap = [(bench.due_ns, number) for number, bench in enumerate(benches)]
    heapq.heapify(heap)
    began_ns: int | None = None
    while heap[0][0] < limit_s * S:
        now_ns, number = heapq.heappop(heap)
        bench = benches[number]
        frame = bench.next_frame()
        if not frame.dropped:
            bench.aligner.settle_command(now_ns)
            if not bench.aligner.settled:
                camera_phases[number] = _unknown_phase(number, tolerance_ns)
            elif camera_phases[number].frame_leader_ns is None or now_ns - told_ns[number] >= REPORT_NS:
                told_ns[number] = now_ns
                camera_phases[number] = _camera_phase(number, bench, shared_goal.goal, tolerance_ns)
                shared_goal.update(camera_phases, now_ns)
            if began_ns is None and all(s.frame_leader_ns is not None for s in camera_phases):
                began_ns = now_ns
            bench.goal, bench.meeting_leader_ns = shared_goal.goal, shared_goal.meeting_leader_ns
            before = len(bench.commands)
            bench.step_aligner(frame, hold=bench.meeting_leader_ns is None)
            if len(bench.commands) > before:
                camera_phases[number] = _unknown_phase(number, tolerance_ns)
            if began_ns is not None and all(
                b.aligner.aligned and b.goal == shared_goal.goal for b in benches
            ):
                return Attempt(sum(len(b.commands) for b in benches), (now_ns - began_ns) / S)
        heapq.heappush(heap, (bench.due_ns, number))
    return Attempt(sum(len(b.commands) for b in benches), None)


def _unknown_phase(number: int, tolerance_ns: int) -> CameraPhase:
    return CameraPhase(str(number), "reset", None, 0.0, tolerance_ns)


def _camera_phase(number: int, bench: Bench, goal: Goal, tolerance_ns: int) -> CameraPhase:
    estimate = bench.aligner.estimate(EXACT, goal, bench.now_ns) if bench.aligner.settled else None
    if estimate is None:
        return _unknown_phase(number, tolerance_ns)
    frame_ns = goal.instant(goal.index_of(bench.now_ns)) + estimate.error_ns
    return CameraPhase(str(number), "reset", frame_ns, estimate.drift_ppm, tolerance_ns)
