"""Commands of the engine to a camera; times in ns."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class InjectFrame:
    """Expose one frame for longer, then go on as before (frame injection)."""

    exposure_ns: int


@dataclass(frozen=True, slots=True)
class RestartStream:
    """Stop the stream, wait, and start it again (reset sampling)."""

    delay_ns: int


@dataclass(frozen=True, slots=True)
class SetFrameDuration:
    """Command to change one frame's duration, from its start to the next one's, but no later frame's."""

    duration_ns: int


CameraCommand = InjectFrame | RestartStream | SetFrameDuration
