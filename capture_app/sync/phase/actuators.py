"""Phase actuators: the interface, and reset sampling, which restarts a stream until its phase fits.

Only a camera's start latency modulo its period matters. A kernel density, a wrapped normal density and a
uniform one predict each next start, weighted by their past predictions (Bayes). A camera whose starts cannot
be predicted is therefore restarted at random, as in the paper.
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
"""Time from a command until the phase is known again."""
REMEMBERED = 24
"""Restarts whose latencies are stored: older ones have less than 0.3 of the newest one's weight
(FORGETTING)."""
WIDTH = 1 / 40
"""Width of the kernels, as a fraction of a period."""
FIRST_WIDTH = 0.1
"""Standard deviation assumed after a single latency, as a fraction of a period."""
FORGETTING = 0.95
"""Factor on the weight of a latency with each later restart: half after 14, so that a slow change shows."""
BACKGROUND = 0.05
"""Fraction of a uniform density in each kernel density, as a start latency may always be a new one."""
AIMS = 256
"""Steps of a period at which the density of latencies is evaluated: six in the width of a kernel (WIDTH)."""
UNSURE = 1.05
"""Minimum likelihood of the best window, relative to a uniform density, for an aimed restart."""


@dataclass(frozen=True, slots=True)
class Move:
    """Request to shift the stream to `target_local_ns` modulo the period; in ns of local time."""

    now_local_ns: int
    target_local_ns: int
    shift_ns: int
    """Delay by which the frames should be shifted, in [0, period)."""
    period_ns: float
    tolerance_ns: int
    off_centre_ns: float = 0.0
    """Delay of the target after the grid instant, in anticipation of drift."""


@dataclass(frozen=True, slots=True)
class InjectionProfile:
    """Response of a device to a long frame, stored for its next use."""

    row_time_ns: int
    gain: float
    neutral_rows: float
    """Longest exposure that does not stretch a frame, in rows."""

    def shift_rows(self, rows: float) -> float:
        """Return the delay in rows of all frames after an exposure of `rows`."""
        return max(0.0, self.gain * (rows - self.neutral_rows))


class PhaseActuator:
    """Means of moving a phase: when a move is worthwhile, its command, and learning from its effect.

    The base class is for a camera whose phase cannot be moved.
    """

    restarts: ClassVar[bool] = False
    """Whether each move starts the stream, so that a single frame may show the new phase."""
    profile: InjectionProfile | None = None
    """Injection profile learned on this device; None if unknown."""
    latencies: Sequence[float] = ()
    """Observed start latencies modulo the period, as fractions of it, newest last."""

    @property
    def problem(self) -> str:
        """Reason why this camera's phase cannot be moved although it should be; empty if it can."""
        return ""

    @property
    def expected_shift_ns(self) -> float | None:
        """Expected shift by the last command, in ns; None if it is uncertain."""
        return None

    @property
    def small_shift_ns(self) -> int | None:
        """Shift by the last command in ns if it is too small to wait for; None otherwise."""
        return None

    @property
    def meets_bursts(self) -> bool:
        """Whether a stream can reach its grid between the order of a burst and its first instant."""
        return False

    def setpoint(
        self, drift: Drift, *, hold_ns: int, aligned: bool, common_instant_ns: int
    ) -> Setpoint | None:
        """Return the setpoint that keeps the stream on the grid for `hold_ns`; None if none is needed.

        `common_instant_ns` is the time until cameras that can only be restarted should meet the grid; 0 for
        none.
        """
        return None

    def setpoint_on_hold(self, drift: Drift) -> Setpoint | None:
        """Return the setpoint for moves that are invisible in images; None for no move."""
        return None

    def setpoint_for_burst(self, drift: Drift, *, begins_ns: int, lasts_ns: int) -> Setpoint | None:
        """Return the setpoint for a burst in `begins_ns` that lasts `lasts_ns`; None for no move."""
        return self.setpoint_on_hold(drift)

    def setpoint_in_recording(self, drift: Drift) -> Setpoint | None:
        """Return the setpoint for a stream that is being recorded; None for no move."""
        return self.setpoint_on_hold(drift)

    def command(self, move: Move) -> CameraCommand | None:
        """Return the command closest to the requested move; None if no command improves on doing nothing."""
        return None

    def learn(self, shift_ns: int | None, noise_ns: float, latency_frames: int | None) -> None:
        """Learn from the last command's shift of the phase, None if unknown; times in ns.

        `latency_frames` counts the frames from the command until the phase had moved; None if unknown.
        """

    def note_start(self, local_ns: int, period_ns: float) -> None:
        """Record a start of the stream (ns, local time), whether or not this actuator commanded it."""

    def learn_start(self, first_frame_local_ns: int) -> None:
        """Learn the start latency from the first frame (ns, local time) of the stream just started."""


class ResetActuator(PhaseActuator):
    """Reset sampling with a chosen delay between stop and start; `aimed=False` waits U(0, period)."""

    restarts = True

    def __init__(self, *, rng: random.Random, aimed: bool = True) -> None:
        self._rng = rng
        self._aimed = aimed
        self.latencies: deque[float] = deque(maxlen=REMEMBERED)
        self._credit = [0.0] * 3
        """Log-likelihood of the latencies under the kernel, normal and uniform densities."""
        self._start_ns: int | None = None
        self._period_ns = 1.0

    def setpoint(
        self, drift: Drift, *, hold_ns: int, aligned: bool, common_instant_ns: int
    ) -> Setpoint | None:
        """Return the setpoint to meet the grid at `common_instant_ns`, else to stay near it, or None."""
        if common_instant_ns > 0:
            return setpoint_to_meet(drift, LEAD_NS, common_instant_ns)
        return None if aligned else setpoint_to_stay(drift, LEAD_NS, hold_ns)

    def command(self, move: Move) -> RestartStream:
        """Return a restart after a delay below one period."""
        self._period_ns = move.period_ns
        latency = self._likeliest_latency(move.tolerance_ns / move.period_ns) if self._aimed else None
        if latency is None:
            delay_ns = int(self._rng.random() * move.period_ns)
        else:
            lead_ns = move.target_local_ns - move.now_local_ns - latency * move.period_ns
            delay_ns = int(lead_ns % move.period_ns)
        self._start_ns = move.now_local_ns + delay_ns
        return RestartStream(delay_ns)

    def note_start(self, local_ns: int, period_ns: float) -> None:
        """Record a start of the stream; one that this actuator commanded is recorded already, and stays."""
        if self._start_ns is None:
            self._start_ns, self._period_ns = local_ns, period_ns

    def learn_start(self, first_frame_local_ns: int) -> None:
        """Add the latency of the start just observed."""
        if self._start_ns is None:
            return
        latency = (first_frame_local_ns - self._start_ns) / self._period_ns % 1.0
        self._start_ns = None
        if self.latencies:
            place = round(latency * AIMS) % AIMS
            for i, density in enumerate((*(densities[place] for densities in self._densities()), 1.0)):
                self._credit[i] += max(-7.0, log(density))
        self._credit = [FORGETTING * credit for credit in self._credit]
        self.latencies.append(latency)

    def _densities(self) -> tuple[list[float], list[float]]:
        """Return the kernel and the normal density of the next latency, at AIMS steps of a period.

        Newer latencies weigh more.
        """
        weights = [FORGETTING**age for age in range(len(self.latencies))]
        total, aged = sum(weights), list(zip(weights, reversed(self.latencies), strict=True))
        kernels, near = [BACKGROUND] * AIMS, ceil(4.0 * WIDTH * AIMS)
        for weight, latency in aged:
            height = (1.0 - BACKGROUND) * weight / (total * WIDTH * sqrt(2.0 * pi))
            for i in range(round(latency * AIMS) - near, round(latency * AIMS) + near + 1):
                kernels[i % AIMS] += height * exp(-0.5 * ((i / AIMS - latency) / WIDTH) ** 2)
        resultant = sum((rect(weight, 2.0 * pi * latency) for weight, latency in aged), 0j) / total
        variance = -2.0 * log(min(max(abs(resultant), 1e-9), 1.0)) / (2.0 * pi) ** 2
        # Fewer latencies give a less certain width.
        width = sqrt((variance * total + FIRST_WIDTH**2) / total * (1.0 + 1.0 / total))
        height = (1.0 - BACKGROUND) / (width * sqrt(2.0 * pi))
        offs = ((i / AIMS - phase(resultant) / (2.0 * pi) + 0.5) % 1.0 - 0.5 for i in range(AIMS))
        return kernels, [BACKGROUND + height * exp(-0.5 * (off / width) ** 2) for off in offs]

    def _likeliest_latency(self, half_window: float) -> float | None:
        """Return the middle of the window most likely to contain the next latency, if one stands out."""
        if not self.latencies:
            return None
        says = [exp(credit - max(self._credit)) for credit in self._credit]
        density = [
            (says[0] * kernel + says[1] * normal + says[2]) / sum(says)
            for kernel, normal in zip(*self._densities(), strict=True)
        ]
        half_aims = max(1, min(AIMS // 2 - 1, round(half_window * AIMS)))
        mass = sum(density[i] for i in range(-half_aims, half_aims + 1))
        max_mass, middle = mass, 0
        for i in range(1, AIMS):
            mass += density[(i + half_aims) % AIMS] - density[i - 1 - half_aims]
            if mass > max_mass:
                max_mass, middle = mass, i
        return None if max_mass < UNSURE * (2 * half_aims + 1) else middle / AIMS
