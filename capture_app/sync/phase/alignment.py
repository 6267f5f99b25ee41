"""Whether a stream is aligned, how sure that is, and how near to its grid stamps and drift let it be."""

from capture_app.camera_facts import PhaseControl
from capture_app.sync.phase.estimator import PhaseEstimator
from capture_app.sync.phase.frame_line import PHASE_FRAMES
from capture_app.text import duration

LANDING_SHARE = {PhaseControl.INJECTION: 0.5, PhaseControl.FRAME_DURATION: 1.0}
"""A stream that can be moved to anywhere is called aligned once it is within this share of its tolerance, and
for as long as it is within all of it: any two that were just aligned are as near to each other as each may
be to the grid, and drift has room."""
MOST_LANDINGS = 8
"""After so many moves the whole tolerance is enough."""
FEWEST_FRAMES = 2
"""Frames since it moved that must say so: one may be late by chance."""


class Alignment:
    """Judges one stream by its error, and by how far off that may be; all in ns."""

    def __init__(self, phase_control: PhaseControl) -> None:
        self._share = LANDING_SHARE.get(phase_control)
        """None where a stream lands by chance: where it seems to be must do then."""
        self.aligned = False
        """Whether the frames were within the tolerance asked for at the last step."""
        self.within_window = False
        """Whether they were within the tolerance in force, which the step of their stamps may widen."""
        self.hurried = False
        """Whether all of its tolerance is enough: it drifts out again before it could be moved twice, or its
        stamps come in coarse steps."""
        self._landings = 0
        self._nearest = False
        self._moved_from_ns: float | None = None

    def clear(self) -> None:
        """Call the stream aligned no more until it is judged again."""
        self.aligned = self.within_window = False

    def note_move(self, error_ns: float) -> None:
        """Note that the stream is moved from where it has that error."""
        self._nearest = False
        self._moved_from_ns = None if self.within_window else error_ns
        self._landings += not self.within_window

    def note_no_better(self) -> None:
        """Note that no move would bring the stream nearer to its grid."""
        self._nearest = True

    def landing_ns(self, inner_ns: int) -> int:
        """How near a move should bring the stream, of what its stamps leave of its tolerance."""
        if self._share is None or self._nearest or self.hurried or self._landings >= MOST_LANDINGS:
            return inner_ns
        return round(self._share * inner_ns)

    def is_open(self, error_ns: float, doubt_ns: float, frames: int, inner_ns: int) -> bool:
        """Whether more frames may show that a stream which is not within its window is."""
        if self._share is None or self.within_window or frames >= PHASE_FRAMES:
            return False
        return abs(error_ns) < self.landing_ns(inner_ns) + doubt_ns

    def judge(
        self, error_ns: float, doubt_ns: float, frames: int, tolerances_ns: tuple[int, int], hidden_ns: float
    ) -> None:
        """Judge by an error that may be off by `doubt_ns`, after so many frames in one place.

        `tolerances_ns` are the one asked for and the one in force, `hidden_ns` what the stamps' step hides.
        """
        if self._moved_from_ns is not None and frames >= FEWEST_FRAMES:
            # Where rows are coarse, the same move only leads to the same place.
            self._nearest = abs(error_ns - self._moved_from_ns) < doubt_ns
            self._moved_from_ns = None
        aligned, within_window = (
            abs(error_ns) <= self._limit_ns(before, tolerance_ns, doubt_ns, frames, hidden_ns)
            for before, tolerance_ns in zip((self.aligned, self.within_window), tolerances_ns, strict=True)
        )
        self.aligned, self.within_window = aligned, within_window
        if within_window:
            self._landings = 0

    def judge_unmoved(self, error_ns: float, tolerances_ns: tuple[int, int], hidden_ns: float) -> None:
        """Judge a stream that is about to move and has not yet: it may only be called aligned no more."""
        asked_ns, in_force_ns = (inner_of(tolerance_ns, hidden_ns) for tolerance_ns in tolerances_ns)
        self.aligned = self.aligned and abs(error_ns) <= asked_ns
        self.within_window = self.within_window and abs(error_ns) <= in_force_ns

    def _limit_ns(
        self, before: bool, tolerance_ns: int, doubt_ns: float, frames: int, hidden_ns: float
    ) -> float:
        inner_ns = inner_of(tolerance_ns, hidden_ns)
        if hidden_ns > doubt_ns:
            return inner_ns - doubt_ns
        if self._share is None:
            # Noise alone should not take a stream out that could only be restarted.
            return inner_ns + min(doubt_ns, inner_ns / 2) if before else inner_ns
        if before:
            return inner_ns
        return self.landing_ns(inner_ns) - doubt_ns if frames >= FEWEST_FRAMES else -1.0


def inner_of(tolerance_ns: int, hidden_ns: float) -> int:
    """What stamps whose step hides so much leave of a tolerance for the error that is seen."""
    return max(0, round(tolerance_ns - hidden_ns))


STEADY_FRAMES = 60
"""After so many frames in one place, their stamps tell all that they can."""
SIGMAS = 4.0
"""Standard deviations of noise that averaging leaves: two where the stream is, two where it is moved to."""
EASED = 0.7
"""A window is made smaller only if it is by this factor: no limit that comes and goes."""
LONG_STAY_NS = 2_000_000_000
"""A stream that stays within its tolerance for longer is held by a correction now and then."""
SHORT_STAY_NS = 1_500_000_000
"""One that stays for less is out again before it could be moved twice."""


class AlignmentWindow:
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
