"""The phase command under way, until its effect shows, and what the effect teaches the actuator."""

from dataclasses import dataclass

from capture_app.sync.phase.actuator import MoveEffect, PhaseActuator
from capture_app.sync.phase.injection import InjectionActuator
from capture_app.sync.phase.reset import ResetActuator
from capture_app.sync.stamps.estimator import TIMEOUT_FRAMES, PhaseEstimator
from capture_app.sync.stamps.frame_stamp import FrameStamp
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

INJECTION_TIMEOUT_NS = 5_000_000_000
RESET_TIMEOUT_NS = 15_000_000_000


@dataclass(frozen=True, slots=True)
class _CommandUnderWay:
    command: CameraCommand
    issued_local_ns: int
    stream: int


class CommandTracker:
    """At most one command at a time for one camera; times in ns of the node's local clock."""

    def __init__(self, phase: PhaseEstimator, actuator: PhaseActuator | None) -> None:
        self._phase = phase
        self._actuator = actuator
        self._under_way: _CommandUnderWay | None = None
        self._stream = -1
        self._first_frame_ns = 0
        self._start_learned = True
        self.corrections = 0
        """Commands so far that moved the phase by more than a few rows."""

    @property
    def under_way(self) -> bool:
        """Whether the effect of a command is still awaited."""
        return self._under_way is not None

    def add_frame(self, stamp: FrameStamp) -> None:
        """Note the first frame of a new stream."""
        if stamp.stream > self._stream:
            self._stream, self._start_learned = stamp.stream, False
            self._first_frame_ns = stamp.timestamp_ns

    def begin(self, command: CameraCommand, now_local_ns: int) -> bool:
        """Expect the effect of a command; False if it must wait for a smaller one before it."""
        actuator = self._actuator
        if actuator is not None and actuator.small_shift_ns is not None:
            self._phase.expect_shift(actuator.small_shift_ns)
            return True
        if self._phase.shift_to_come(now_local_ns):
            return False
        self._under_way = _CommandUnderWay(command, now_local_ns, self._stream)
        self.corrections += 1
        if not isinstance(command, RestartStream):
            self._phase.mark_disturbance(actuator.expected_shift_ns if actuator else None)
        return True

    def update(self, now_local_ns: int, *, run_settled: bool) -> None:
        """End the command under way once its effect shows or is overdue, and learn from the effect.

        `run_settled`: whether the phase since its last move is known well.
        """
        under_way = self._under_way
        if under_way is not None:
            waited_ns = now_local_ns - under_way.issued_local_ns
            if isinstance(under_way.command, RestartStream):
                done = self._stream > under_way.stream and run_settled
                overdue = waited_ns > RESET_TIMEOUT_NS + under_way.command.delay_ns
            else:
                done = not self._phase.disturbed
                overdue = waited_ns > INJECTION_TIMEOUT_NS + 2 * TIMEOUT_FRAMES * self._phase.period_ns
            if not done and not overdue:
                return
            self._under_way = None
            if overdue:
                return
            if isinstance(self._actuator, InjectionActuator):
                self._learn(self._phase.last_ns, self._phase.last_shift_ns)
        if isinstance(self._actuator, ResetActuator) and not self._start_learned and run_settled:
            self._start_learned = True
            self._learn(self._phase.nearest_frame_ns(self._first_frame_ns), None)

    def _learn(self, frame_local_ns: int, shift_ns: int | None) -> None:
        assert self._actuator is not None
        phase = self._phase
        self._actuator.learn(MoveEffect(frame_local_ns, shift_ns, phase.noise_ns, phase.last_latency_frames))
