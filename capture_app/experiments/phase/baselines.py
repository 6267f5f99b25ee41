"""The paper's way of bringing cameras into phase, as models without frames, and the crystals' errors."""

import heapq
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from capture_app.simulation.profiles import SensorProfile

S = 1_000_000_000
PAPERS_SLEEP_NS = S
"""The paper's way sleeps U(0, 1 s) before each start, and one frame shows the phase: 1.23 s in all."""
PPM = 20.0
"""Crystals of cameras that restart are off by about so much."""
LIB_OVERHEAD_NS = 200_000
LIB_LEAST_NS = 50_000
LIB_WAIT_NS = 400_000_000
LIB_MOST = 50
"""Of libsoftwaresync's rule: its constants, its pause between injections, and when we stop counting."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """What it took: injections or restarts, and seconds from the first of them; None for never."""

    moves: int
    seconds: float | None


@dataclass(slots=True)
class Attempts:
    """What all trials took, by device and way."""

    injections: dict[str, dict[str, list[Attempt]]] = field(default_factory=dict)
    restarts: dict[str, dict[str, list[Attempt]]] = field(default_factory=dict)


def inject_like_libsoftwaresync(profile: SensorProfile, seed: int, tolerance_ns: int) -> Attempt:
    """The paper's way as its published code has it: exposure = T + d/2 - overhead, again and again."""
    rng = random.Random(seed)
    period_ns, drift = profile.period_ns, rng.gauss(0.0, 15e-6)
    error_ns = rng.uniform(-period_ns / 2, period_ns / 2)
    for moves in range(LIB_MOST + 1):
        if abs(error_ns + rng.gauss(0.0, profile.timestamp_noise_ns)) <= tolerance_ns:
            return Attempt(moves, moves * LIB_WAIT_NS / S)
        later_ns = -error_ns % period_ns
        exposure_ns = max(period_ns + LIB_LEAST_NS, period_ns + later_ns / 2 - LIB_OVERHEAD_NS)
        error_ns += profile.shift_ns(round(exposure_ns)) + drift * LIB_WAIT_NS
        error_ns = (error_ns + period_ns / 2) % period_ns - period_ns / 2
    return Attempt(LIB_MOST, None)


def uniform_ppm(rng: random.Random) -> float:
    """Error of a crystal that is at most PPM off."""
    return rng.uniform(-PPM, PPM)


def restart_like_the_paper(
    profile: SensorProfile,
    count: int,
    seed: int,
    tolerance_ns: int,
    *,
    crystal_ppm: Callable[[random.Random], float] = uniform_ppm,
    limit_s: float = 5000.0,
) -> Attempt:
    """The paper's way with restarts: each camera by itself, against one goal, until all are in at one moment.

    A model of restarts and drift without frames: a camera that drifts out of the tolerance is restarted.
    """
    rng = random.Random(seed)
    period_ns = profile.period_ns
    drifts = [crystal_ppm(rng) * 1e-6 for _ in range(count)]
    since_ns = [0.0] * count
    phases_ns = [rng.uniform(-period_ns / 2, period_ns / 2) for _ in range(count)]
    mean_ns, sd_ns = profile.start_latency_ns
    moves, now_ns = 0, 0.0
    due: list[tuple[float, int]] = [(0.0, camera) for camera in range(count)]

    def inside_until(camera: int) -> float:
        """When that camera leaves the tolerance; before now if it is outside already."""
        error_ns = phases_ns[camera] + drifts[camera] * (now_ns - since_ns[camera])
        if abs(error_ns) > tolerance_ns:
            return now_ns - 1.0
        drift = drifts[camera]
        room_ns = tolerance_ns - error_ns if drift > 0 else tolerance_ns + error_ns
        return now_ns + room_ns / max(abs(drift), 1e-12)

    landed = [False] * count
    while due and now_ns < limit_s * S:
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
