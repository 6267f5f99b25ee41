"""What was measured of a camera."""

from statistics import median

from msgspec import Struct

from capture_app.camera_facts import CameraFacts
from capture_app.sync.phase.injection import InjectionProfile


class Moves(Struct, frozen=True, kw_only=True):
    """What commands did to the phase; times in ns, None where the stream did not show it."""

    commands: int
    effective: int
    """How many of them moved it."""
    latency_frames: tuple[int, int] | None = None
    """Fewest and most frames from a command until the phase had moved."""
    step_ns: float | None = None
    """What all shifts are multiples of: a row, times the gain of an injection."""
    row_time_ns: float | None = None
    """Of one row, by that step."""
    injection: InjectionProfile | None = None
    overhead_ns: float | None = None
    """How much longer than its exposure a frame is, by the injections."""
    reason: str = ""
    """Why something is not known."""


class Starts(Struct, frozen=True, kw_only=True):
    """How long starts took, from the command to the first frame's stamp, in ns."""

    latencies_ns: tuple[int, ...]
    by_restart: bool
    """By restarts of the stream; else the camera was closed and opened anew."""

    @property
    def median_ns(self) -> float:
        """In the middle."""
        return median(self.latencies_ns)

    @property
    def spread_ns(self) -> int:
        """From the quickest to the slowest."""
        return max(self.latencies_ns) - min(self.latencies_ns)


class Character(Struct, frozen=True, kw_only=True):
    """One camera in one mode; times in ns, by this machine's clock."""

    spec: str
    camera: CameraFacts
    modes: str
    """All that it offers, in its driver's words."""
    frames: int
    drops: int
    period_ns: float
    rate_error_ppm: float
    """By how much it is faster than its nominal rate."""
    stamp_step_ns: float
    """The step that its stamps come in; 0 where it is too fine to matter."""
    stamp_jitter_ns: float
    """Standard deviation of a stamp about the line of its stream's."""
    delivery_ns: int
    """From a frame's stamp to its arrival, in the middle."""
    slowest_delivery_ns: int
    exposures_ns: tuple[int, int] | None = None
    """The least and the most of the frames that were watched; None where they do not tell."""
    starts: Starts | None = None
    moves: Moves | None = None
    """None for a camera whose phase is moved by restarts, or not at all."""
    saved: bool = False
    """It is kept in this machine's profiles, by which nodes move such cameras from their first command on."""
