"""What the ways of moving a stream's phase have in common."""

from dataclasses import dataclass
from typing import Protocol

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
    """How much later than the goal's own instant the wanted one is, to meet the drift half-way."""


@dataclass(frozen=True, slots=True)
class MoveEffect:
    """What became of a move: when a frame starts now, and how far the phase moved, if anybody can tell."""

    frame_local_ns: int
    shift_ns: int | None
    noise_ns: float


class PhaseActuator(Protocol):
    """One way of moving a phase: it turns wishes into commands, and learns what they do."""

    @property
    def problem(self) -> str:
        """Why this camera can never be moved, in plain words; empty if it can."""

    def command(self, move: Move) -> CameraCommand | None:
        """The command that comes nearest to the wish; None if doing nothing does."""

    def learn(self, moved: MoveEffect) -> None:
        """Take in what the last command did."""
