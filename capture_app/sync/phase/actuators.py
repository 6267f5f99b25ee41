"""Moving a stream's phase: the interface, and reset sampling, which restarts it until its phase is right.

A camera's start latency modulo its period is all that counts. A kernel density, a wrapped normal one and
a uniform one predict each next start, weighted by how well they predicted (Bayes), so that a camera whose
starts cannot be predicted is restarted at random, as in the paper.
"""

import random
from cmath import phase, rect
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, exp, log, pi, sqrt
from typing import ClassVar

from capture_app.sync.phase.frame_grid import Drift, Setpoint, setpoint_to_meet, setpoint_to_stay
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

LEAD_NS = 1_000_000_000
"""From a command until the phase is known again."""
REMEMBERED = 24
WIDTH = 1 / 40
"""Width of the kernels, as a share of a period."""
FIRST_WIDTH = 0.1
"""Spread that is assumed after a single latency."""
FORGETTING = 0.95
BACKGROUND = 0.05
"""Share of a uniform density in each kernel density: a start latency may always be a new one."""
AIMS = 256
UNSURE = 1.05
"""Aim only if the best window is so much more likely than under a uniform density."""


@dataclass(frozen=True, slots=True)
class Move:
    """A wish: frames should start where a frame at `wanted_local_ns` would; times in ns of local time."""

    now_local_ns: int
    wanted_local_ns: int
    shift_ns: int
    """How much later than now the frames should come, in [0, period)."""
    period_ns: float
    tolerance_ns: int
    off_centre_ns: float = 0.0
    """How much later than the grid's own instant the wanted one is, in advance of the drift."""


@dataclass(frozen=True, slots=True)
class InjectionProfile:
    """How a device responds to a long frame, kept for its next use."""

    row_time_ns: int
    gain: float
    neutral_rows: float
    """Longest exposure that does not stretch a frame, in rows."""

    def shift_rows(self, rows: float) -> float:
        """By how many rows an exposure of so many delays all frames after it."""
        return max(0.0, self.gain * (rows - self.neutral_rows))


class PhaseActuator:
    """One way of moving a phase: when a move is worth it, its command, and what its effect teaches.

    By itself it is that of a camera whose phase cannot be moved.
    """

    restarts: ClassVar[bool] = False
    """Whether each move is a start of the stream, after which one frame may tell the phase."""
    profile: InjectionProfile | None = None
    """What long frames have shown about this device."""
    latencies: Sequence[float] = ()
    """Start latencies seen, modulo the period and as shares of it, newest last."""

    @property
    def problem(self) -> str:
        """Why this camera can never be moved though it should be, in plain words; empty if it can."""
        return ""

    @property
    def expected_shift_ns(self) -> float | None:
        """How far the last command moves the phase, None where that is not sure."""
        return None

    @property
    def small_shift_ns(self) -> int | None:
        """How far the last command moves the phase where that is so little that nobody waits for it."""
        return None

    @property
    def meets_bursts(self) -> bool:
        """Whether a stream can be brought to the grid between the order of a burst and its first instant."""
        return False

    def setpoint(self, drift: Drift, *, hold_ns: int, aligned: bool, meeting_ns: int) -> Setpoint | None:
        """Where the stream should be moved to stay for `hold_ns`; None if nothing is to be done.

        `meeting_ns` is the time until cameras that can only be restarted are to meet the grid, 0 for none.
        """
        return None

    def setpoint_on_hold(self, drift: Drift) -> Setpoint | None:
        """Where the stream should be moved while nothing may show in pictures; None for not at all."""
        return None

    def setpoint_for_burst(self, drift: Drift, *, begins_ns: int, lasts_ns: int) -> Setpoint | None:
        """Where the stream should be moved for a burst that begins so much later, and lasts so long."""
        return self.setpoint_on_hold(drift)

    def command(self, move: Move) -> CameraCommand | None:
        """The command that comes nearest to the wish; None if doing nothing does."""
        return None

    def learn(self, shift_ns: int | None, noise_ns: float, latency_frames: int | None) -> None:
        """Learn how far the last command moved the phase, None if it is not known; times in ns.

        `latency_frames` are those from the command until the phase had moved, None where that is not known.
        """

    def note_start(self, local_ns: int, period_ns: float) -> None:
        """Note that the stream was started at that local time, by a command of ours or not."""

    def learn_start(self, first_frame_local_ns: int) -> None:
        """Learn from the first frame of the stream just started."""


class ResetActuator(PhaseActuator):
    """Chooses how long to wait between stop and start; `aimed=False` waits U(0, period)."""

    restarts = True

    def __init__(self, *, rng: random.Random, aimed: bool = True) -> None:
        self._rng = rng
        self._aimed = aimed
        self.latencies: deque[float] = deque(maxlen=REMEMBERED)
        self._credit = [0.0] * 3
        """Log-likelihood of the latencies by kernels, by the normal density and by the uniform one."""
        self._start_ns: int | None = None
        self._period_ns = 1.0

    def setpoint(self, drift: Drift, *, hold_ns: int, aligned: bool, meeting_ns: int) -> Setpoint | None:
        """Where the stream meets the grid in `meeting_ns`, or stays near it; None if no restart is needed."""
        if meeting_ns > 0:
            return setpoint_to_meet(drift, LEAD_NS, meeting_ns)
        return None if aligned else setpoint_to_stay(drift, LEAD_NS, hold_ns)

    def command(self, move: Move) -> RestartStream:
        """Restart after a delay below one period."""
        self._period_ns = move.period_ns
        latency = self._likeliest_latency(move.tolerance_ns / move.period_ns) if self._aimed else None
        if latency is None:
            delay_ns = int(self._rng.random() * move.period_ns)
        else:
            lead_ns = move.wanted_local_ns - move.now_local_ns - latency * move.period_ns
            delay_ns = int(lead_ns % move.period_ns)
        self._start_ns = move.now_local_ns + delay_ns
        return RestartStream(delay_ns)

    def note_start(self, local_ns: int, period_ns: float) -> None:
        """Note a start that was not commanded here; of one that was, more is known."""
        if self._start_ns is None:
            self._start_ns, self._period_ns = local_ns, period_ns

    def learn_start(self, first_frame_local_ns: int) -> None:
        """Take in the latency of the start just seen."""
        if self._start_ns is None:
            return
        latency = (first_frame_local_ns - self._start_ns) / self._period_ns % 1.0
        self._start_ns = None
        if self.latencies:
            densities = self._density(latency), self._normal_density(latency), 1.0
            for i, density in enumerate(densities):
                self._credit[i] += max(-7.0, log(density))
        self._credit = [FORGETTING * credit for credit in self._credit]
        self.latencies.append(latency)

    def _density(self, at: float) -> float:
        """Predicted density of a latency, as a share of a period; the newer a latency, the more it counts."""
        total = mass = 0.0
        weight = 1.0
        for latency in reversed(self.latencies):
            off = (at - latency + 0.5) % 1.0 - 0.5
            mass += weight * exp(-0.5 * (off / WIDTH) ** 2)
            total += weight
            weight *= FORGETTING
        return BACKGROUND + (1.0 - BACKGROUND) * mass / (total * WIDTH * sqrt(2.0 * pi))

    def _normal(self) -> tuple[float, float]:
        """Middle and width of the wrapped normal density that the latencies suggest."""
        weights = [FORGETTING**age for age in range(len(self.latencies))]
        total = sum(weights)
        pairs = zip(weights, reversed(self.latencies), strict=True)
        resultant = sum((rect(w, 2.0 * pi * latency) for w, latency in pairs), 0j) / total
        variance = -2.0 * log(min(max(abs(resultant), 1e-9), 1.0)) / (2.0 * pi) ** 2
        # The fewer the latencies, the less they say about their spread.
        variance = (variance * total + FIRST_WIDTH**2) / total * (1.0 + 1.0 / total)
        return phase(resultant) / (2.0 * pi) % 1.0, sqrt(variance)

    def _normal_density(self, at: float) -> float:
        middle, width = self._normal()
        off = (at - middle + 0.5) % 1.0 - 0.5
        return BACKGROUND + (1.0 - BACKGROUND) * exp(-0.5 * (off / width) ** 2) / (width * sqrt(2.0 * pi))

    def _likeliest_latency(self, half_window: float) -> float | None:
        """Middle of the window that most likely holds the next latency; None if all are alike."""
        if not self.latencies:
            return None
        best = max(self._credit)
        says = [exp(credit - best) for credit in self._credit]
        total = sum(says)
        density = [says[-1] / total + BACKGROUND * (1.0 - says[-1] / total)] * AIMS
        at, width = self._normal()
        height = (1.0 - BACKGROUND) * says[-2] / total / (width * sqrt(2.0 * pi))
        for i in range(AIMS):
            off = (i / AIMS - at + 0.5) % 1.0 - 0.5
            density[i] += height * exp(-0.5 * (off / width) ** 2)
        ages = [FORGETTING**age for age in range(len(self.latencies))]
        height, near = says[0] / total / (sum(ages) * WIDTH * sqrt(2.0 * pi)), ceil(4.0 * WIDTH * AIMS)
        for latency, weight in zip(reversed(self.latencies), ages, strict=True):
            middle = round(latency * AIMS)
            for i in range(middle - near, middle + near + 1):
                off = i / AIMS - latency
                density[i % AIMS] += (1.0 - BACKGROUND) * height * weight * exp(-0.5 * (off / WIDTH) ** 2)
        reach = max(1, min(AIMS // 2 - 1, round(half_window * AIMS)))
        mass = sum(density[i] for i in range(-reach, reach + 1))
        most, middle = mass, 0
        for i in range(1, AIMS):
            mass += density[(i + reach) % AIMS] - density[i - 1 - reach]
            if mass > most:
                most, middle = mass, i
        if most < UNSURE * (2 * reach + 1):
            return None
        return middle / AIMS
