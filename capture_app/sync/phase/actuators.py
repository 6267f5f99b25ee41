"""Moving a stream's phase: the interface, and restarts.

An actuator: one way of moving the phase of a stream.

Reset sampling: restart the stream until its phase is right, aimed with the start latencies seen so far.

A camera's start latency modulo its period is all that counts. Kernel densities of several widths, one wrapped
normal density and a uniform one predict each next start, weighted by how well they predicted (Bayes), so
that a camera whose starts cannot be predicted is restarted at random, as in the paper.
"""

import random
from abc import ABC, abstractmethod
from cmath import phase, rect
from collections import deque
from dataclasses import dataclass
from math import ceil, exp, log, pi, sqrt

from capture_app.sync.phase.goal import Aim, Course, aim_to_meet, aim_to_stay
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream


@dataclass(frozen=True, slots=True)
class Move:
    """A wish: frames should start where a frame at `wanted_local_ns` would; times in ns of local time."""

    now_local_ns: int
    wanted_local_ns: int
    shift_ns: int
    """How much later than now the frames should come, in [0, period)."""
    period_ns: float
    tolerance_ns: int
    aim_ns: float = 0.0
    """How much later than the goal's own instant the wanted one is, in advance of the drift."""


@dataclass(frozen=True, slots=True)
class MoveEffect:
    """The effect of a move: when a frame starts now, and how far the phase moved, None if it is not known."""

    frame_local_ns: int
    shift_ns: int | None
    noise_ns: float
    latency_frames: int | None = None
    """Frames from the command until the phase had moved, None where that is not known."""


class PhaseActuator(ABC):
    """One way of moving a phase: when a move is worth it, its command, and what its effect teaches."""

    @property
    def problem(self) -> str:
        """Why this camera can never be moved, in plain words; empty if it can."""
        return ""

    @property
    def expected_shift_ns(self) -> float | None:
        """How far the last command moves the phase, None where that is not sure."""
        return None

    @property
    def small_shift_ns(self) -> int | None:
        """How far the last command moves the phase where that is so little that nobody waits for it."""
        return None

    @abstractmethod
    def aim(self, course: Course, *, hold_ns: int, aligned: bool, meeting_ns: int) -> Aim | None:
        """Where the stream should be moved to stay for `hold_ns`; None if nothing is to be done.

        `meeting_ns` is the time until cameras that can only be restarted are to meet the goal, 0 for none.
        """

    def aim_on_hold(self, course: Course) -> Aim | None:
        """Where the stream should be moved while nothing may show in pictures; None for not at all."""
        return None

    def aim_before_burst(self, course: Course, *, begins_ns: int, lasts_ns: int) -> Aim | None:
        """Where the stream should be moved for a burst that begins so much later, and lasts so long."""
        return self.aim_on_hold(course)

    @abstractmethod
    def command(self, move: Move) -> CameraCommand | None:
        """The command that comes nearest to the wish; None if doing nothing does."""

    @abstractmethod
    def learn(self, effect: MoveEffect) -> None:
        """Learn from the effect of the last command."""


LEAD_NS = 1_000_000_000
"""From a command until the phase is known again."""
REMEMBERED = 24
WIDTHS = (1 / 200, 1 / 60, 1 / 20)
"""Of the kernels, as shares of a period."""
FIRST_WIDTH = 0.1
"""Spread that is assumed after a single latency."""
FORGETTING = 0.95
BACKGROUND = 0.05
"""Share of a uniform density in each kernel density: a start latency may always be a new one."""
AIMS = 256
UNSURE = 1.05
"""Aim only if the best window is so much more likely than under a uniform density."""


class ResetActuator(PhaseActuator):
    """Chooses how long to wait between stop and start; `aimed=False` waits U(0, period)."""

    def __init__(self, *, rng: random.Random, aimed: bool = True) -> None:
        self._rng = rng
        self._aimed = aimed
        self._latencies: deque[float] = deque(maxlen=REMEMBERED)
        """As shares of a period, newest last."""
        self._credit = [0.0] * (len(WIDTHS) + 2)
        """Log-likelihood of the latencies, by kernel width; the normal and the uniform density's are last."""
        self._start_ns: int | None = None
        self._period_ns = 1.0

    @property
    def latencies(self) -> tuple[float, ...]:
        """The start latencies seen, modulo the period and as shares of it, newest last."""
        return tuple(self._latencies)

    def aim(self, course: Course, *, hold_ns: int, aligned: bool, meeting_ns: int) -> Aim | None:
        """Where the stream meets the goal in `meeting_ns`, or stays near it; None if no restart is needed."""
        if meeting_ns > 0:
            return aim_to_meet(course, LEAD_NS, meeting_ns)
        return None if aligned else aim_to_stay(course, LEAD_NS, hold_ns)

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
        """A stream was started at that local time without a command of ours."""
        if self._start_ns is None:
            self._start_ns, self._period_ns = local_ns, period_ns

    def learn(self, effect: MoveEffect) -> None:
        """Take in the latency of the start just seen."""
        if self._start_ns is None:
            return
        latency = (effect.frame_local_ns - self._start_ns) / self._period_ns % 1.0
        self._start_ns = None
        if self._latencies:
            densities = [self._density(width, latency) for width in WIDTHS]
            densities += [self._normal_density(latency), 1.0]
            for i, density in enumerate(densities):
                self._credit[i] += max(-7.0, log(density))
        self._credit = [FORGETTING * credit for credit in self._credit]
        self._latencies.append(latency)

    def _density(self, width: float, at: float) -> float:
        """Predicted density of a latency, as a share of a period; the newer a latency, the more it counts."""
        total = mass = 0.0
        weight = 1.0
        for latency in reversed(self._latencies):
            off = (at - latency + 0.5) % 1.0 - 0.5
            mass += weight * exp(-0.5 * (off / width) ** 2)
            total += weight
            weight *= FORGETTING
        return BACKGROUND + (1.0 - BACKGROUND) * mass / (total * width * sqrt(2.0 * pi))

    def _normal(self) -> tuple[float, float]:
        """Middle and width of the wrapped normal density that the latencies suggest."""
        weights = [FORGETTING**age for age in range(len(self._latencies))]
        total = sum(weights)
        pairs = zip(weights, reversed(self._latencies), strict=True)
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
        if not self._latencies:
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
        ages = [FORGETTING**age for age in range(len(self._latencies))]
        for width, say in zip(WIDTHS, says, strict=False):
            height = (1.0 - BACKGROUND) * say / total / (sum(ages) * width * sqrt(2.0 * pi))
            near = min(AIMS // 2, ceil(4.0 * width * AIMS))
            for latency, weight in zip(reversed(self._latencies), ages, strict=True):
                middle = round(latency * AIMS)
                for i in range(middle - near, middle + near + 1):
                    off = i / AIMS - latency
                    density[i % AIMS] += height * weight * exp(-0.5 * (off / width) ** 2)
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
