"""Input and result of a phase estimate: the stamps of frames, and the error of a stream."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FrameStamp:
    """The driver's number and timestamp of one frame; the time in ns of the node's local clock.

    `stream` counts the stream's starts: sequence numbers compare only within one stream.
    """

    sequence: int
    stream: int
    timestamp_ns: int


@dataclass(frozen=True, slots=True)
class StampError:
    """What is known of one timestamp's error; times in ns."""

    outlier_ns: int = 0
    """How far it lies off the line of its stream's frames; where not 0, the line tells the frame's time."""
    uncertainty_ns: float = 0.0
    """How far off that time may be, in 95 of 100 cases, for the stamps' noise and the step they come in."""
    hard_bound_ns: float = 0.0
    """How far at most, for that step."""


@dataclass(frozen=True, slots=True)
class PhaseEstimate:
    """The error of a stream against its goal at one instant of leader time."""

    error_ns: int
    """Signed distance of the nearest frame from the nearest goal instant, in [-period/2, period/2)."""
    period_ns: int
    """Of the camera, in leader time; the drift says it more finely."""
    drift_ppm: float
    """Change of the error, in us per second."""
    sigma_ns: float
    """One standard deviation of the error from the timestamps' noise; the clock's comes on top."""
    frames: int
    """Frames since the phase last moved."""
    at_leader_ns: int
    quantum_error_ns: float = 0.0
    """What the step that the timestamps come in may hide of the error, either way."""

    @property
    def uncertainty_ns(self) -> float:
        """How far off the error may be, in 95 of 100 cases; the clock's uncertainty comes on top."""
        return 2.0 * self.sigma_ns + self.quantum_error_ns
