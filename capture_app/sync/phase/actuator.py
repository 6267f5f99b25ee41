"""An actuator: one way of moving the phase of a stream."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from capture_app.sync.phase.aim import Aim, Course
from capture_app.sync.wire.camera_commands import CameraCommand


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
