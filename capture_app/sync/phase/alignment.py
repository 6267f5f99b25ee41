"""Whether a stream is aligned, how sure that is, and how near to its grid stamps and drift let it be."""

from capture_app.camera_facts import PhaseControl
from capture_app.sync.phase.estimator import PhaseEstimator
from capture_app.sync.phase.frame_line import PHASE_FRAMES
from capture_app.sync.phase.stamps import PhaseEstimate
from capture_app.text import duration

STEADY_FRAMES = 60
"""After so many frames in one place, their stamps tell all that they can."""
SIGMAS = 4.0
"""Standard deviations of noise that averaging leaves: two where the stream is, two where it is moved to."""
EASED = 0.7
"""A window is made smaller only if it is by this factor: no limit that comes and goes."""
LANDING_SHARE = 0.5
"""A stream is at first called aligned once it is within this share of its tolerance, and for as long as it is
within all of it: where two lie by chance they would be twice as far from each other as from the grid."""
LONG_STAY_NS = 2_000_000_000
"""A stream that stays within its tolerance for longer is held by a correction now and then."""


class AlignmentWindow:
    """Judges one stream by the tolerance asked for, or what its timestamps allow; all in ns."""

    def __init__(self, asked_ns: int, phase_control: PhaseControl) -> None:
        self.asked_ns = asked_ns
        self.reachable_ns = 0
        """Smallest tolerance that the step of the timestamps allows, 0 where they come in fine steps."""
        self.stay_ns = float("inf")
        """How long drift leaves the stream within its tolerance, from one end of it to the other."""
        self.aligned = False
        """Whether the frames were within the tolerance asked for at the last step."""
        self.within_window = False
        """Whether they were within the tolerance in force, which the step of their stamps may widen."""
        self._moves = phase_control in (PhaseControl.INJECTION, PhaseControl.FRAME_DURATION)
        """Whether it goes where it is moved; else it lands by chance, and where it seems to be must do."""
        self.landing_share = LANDING_SHARE if phase_control is PhaseControl.INJECTION else 1.0
        """Within how much of its tolerance it is called aligned; moved twice, it is where it can be."""
        self._quantum_ns = self._hidden_ns = self._drift_ppm = 0.0

    @property
    def tolerance_ns(self) -> int:
        """The tolerance in force."""
        return max(self.asked_ns, self.reachable_ns)

    @property
    def inner_ns(self) -> int:
        """What stamps whose step hides some of the error leave of the tolerance in force for what is seen."""
        return self._inner_ns(self.tolerance_ns)

    @property
    def drifts_fast(self) -> bool:
        """Whether the stream leaves its tolerance too soon to be called held."""
        return self.stay_ns < LONG_STAY_NS

    def clear(self) -> None:
        """Call the stream aligned no more until it is judged again."""
        self.aligned = self.within_window = False

    def is_open(self, now: PhaseEstimate) -> bool:
        """Whether more frames may show that a stream which is not within its window is."""
        if not self._moves or self.within_window or now.frames >= PHASE_FRAMES:
            return False
        return abs(now.error_ns) < self.landing_share * self.inner_ns + 2.0 * now.sigma_ns

    def judge(self, now: PhaseEstimate) -> None:
        """Judge a stream that is settled by its error now."""
        self.aligned = abs(now.error_ns) <= self._limit_ns(self.aligned, self.asked_ns, now)
        self.within_window = abs(now.error_ns) <= self._limit_ns(self.within_window, self.tolerance_ns, now)

    def judge_unmoved(self, error_ns: float) -> None:
        """Judge a stream that is about to move and has not yet: it may only be called aligned no more."""
        self.aligned = self.aligned and abs(error_ns) <= self._inner_ns(self.asked_ns)
        self.within_window = self.within_window and abs(error_ns) <= self.inner_ns

    def _limit_ns(self, before: bool, tolerance_ns: int, now: PhaseEstimate) -> float:
        inner_ns, doubt_ns = self._inner_ns(tolerance_ns), 2.0 * now.sigma_ns
        if self._hidden_ns > doubt_ns:
            return inner_ns - doubt_ns
        if self._moves and not before:
            return self.landing_share * inner_ns - doubt_ns
        # Noise alone should not take a stream out that could only be restarted.
        return inner_ns + min(doubt_ns, inner_ns / 2) if before and not self._moves else inner_ns

    def _inner_ns(self, tolerance_ns: int) -> int:
        return max(0, round(tolerance_ns - self._hidden_ns))

    def update(self, phase: PhaseEstimator, drift_ppm: float) -> None:
        """Take in what is known of a stream that is settled, and its drift in us per second."""
        self._quantum_ns, self._drift_ppm = phase.quantum_ns, drift_ppm
        hidden_ns = self._hidden_ns = phase.quantum_error_ns
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
