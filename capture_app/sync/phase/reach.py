"""How near to its goal a stream can be brought, and for how long it stays, by its stamps and its drift."""

from capture_app.sync.stamps.estimator import PhaseEstimator
from capture_app.text import duration

STEADY_FRAMES = 60
"""After so many frames in one place, their stamps tell all that they can."""
SIGMAS = 4.0
"""Of noise that averaging leaves: two where the stream is, two where it is moved to."""
EASED = 0.7
"""A reach is made smaller only if it is by this factor: no limit that comes and goes."""
LONG_STAY_NS = 2_000_000_000
"""A stream that stays within its tolerance for longer is held by a correction now and then."""
SHORT_STAY_NS = 1_500_000_000
"""One that stays for less is out again before it could be moved twice."""


class Reach:
    """The tolerance in force for one stream: the one asked for, or what its timestamps allow; in ns."""

    def __init__(self, asked_ns: int) -> None:
        self.asked_ns = asked_ns
        self.reachable_ns = 0
        """Smallest tolerance that the step of the timestamps allows, 0 where they come in fine steps."""
        self.stay_ns = float("inf")
        """How long drift leaves the stream within its tolerance, from one end of it to the other."""
        self._quantum_ns = self._drift_ppm = 0.0

    @property
    def tolerance_ns(self) -> int:
        """The tolerance in force."""
        return max(self.asked_ns, self.reachable_ns)

    @property
    def tolerances_ns(self) -> tuple[int, int]:
        """The tolerance asked for, and the one in force."""
        return self.asked_ns, self.tolerance_ns

    @property
    def drifts_fast(self) -> bool:
        """Whether the stream leaves its tolerance too soon to be called held."""
        return self.stay_ns < LONG_STAY_NS

    def update(self, phase: PhaseEstimator, drift_ppm: float) -> None:
        """Take in what is known of a stream that is settled, and its drift in us per second."""
        self._quantum_ns, self._drift_ppm = phase.quantum_ns, drift_ppm
        hidden_ns = phase.quantum_error_ns
        if not hidden_ns:
            self.reachable_ns = 0
        elif not self.reachable_ns or phase.run_frames >= STEADY_FRAMES:
            # What is hidden limits what is known, and the finest step by which a move can be aimed.
            aimed_ns = hidden_ns - phase.quantum_ns / 4
            reachable_ns = round(hidden_ns + aimed_ns + SIGMAS * phase.sigma_at(phase.last_ns))
            if not EASED * self.reachable_ns < reachable_ns <= self.reachable_ns:
                self.reachable_ns = reachable_ns
        self.stay_ns = 2e6 * self.tolerance_ns / max(abs(drift_ppm), 1e-3)

    @property
    def coarseness(self) -> str:
        """Why the tolerance asked for is not met, in plain words; empty where it is."""
        if self.reachable_ns <= self.asked_ns:
            return ""
        return (
            f"its timestamps come in steps of {duration(self._quantum_ns)}: aligned to"
            f" ±{duration(self.reachable_ns)}, asked for ±{duration(self.asked_ns)}"
        )

    @property
    def fleetingness(self) -> str:
        """For how long the stream is aligned where that is short, in plain words; else empty."""
        if not self.drifts_fast:
            return ""
        return (
            f"drifts {duration(abs(self._drift_ppm) * 1000)} a second: within ±{duration(self.tolerance_ns)}"
            f" for {duration(self.stay_ns)} at a time, and brought there again for each burst"
        )
