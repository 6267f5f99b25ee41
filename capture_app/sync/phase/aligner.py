"""Alignment of one camera's frames to the rig's grid: when to move the phase, by what shift, and the result.

Also whether the frames are aligned, with what uncertainty, and the accuracy that their timestamps and drift
allow.
"""

import random

from capture_app.common.camera_facts import CameraFacts, PhaseControl
from capture_app.common.text import duration
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.actuators import InjectionProfile, Move, PhaseActuator, ResetActuator
from capture_app.sync.phase.estimator import TIMEOUT_FRAMES, FrameStamp, PhaseEstimate, PhaseEstimator
from capture_app.sync.phase.frame_grid import Drift, FrameGrid, Setpoint
from capture_app.sync.phase.frame_line import PHASE_FRAMES, QUANTIZED_FRAMES
from capture_app.sync.phase.injection import FrameDurationActuator, InjectionActuator
from capture_app.sync.phase.period_choice import MAX_DRIFT_PPM
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

STEADY_FRAMES = 60
"""Frames without a move after which more timestamps add no information."""
SIGMAS = 4.0
"""Standard deviations of the averaged noise within a tolerance: two for the stream, two for its target."""
EASED = 0.7
"""A tolerance window shrinks only by at least this factor, so that its limit does not flicker."""
LANDING_FRACTION = 0.5
"""Fraction of the tolerance within which a stream first counts as aligned; it stays so up to the whole.

Two streams that land by chance are up to twice as far from each other as from the grid.
"""
LONG_STAY_NS = 2_000_000_000
"""Minimum time within the tolerance for a stream that occasional corrections can hold there."""
INJECTION_TIMEOUT_NS, RESET_TIMEOUT_NS = 5_000_000_000, 15_000_000_000
"""Times after which a command that shows no effect is given up: the longest latency of an injection is 13
frames, 0.43 s at 30 fps, to which 60 frames are added; a restart takes 0.8 s on average."""
WARM_FRAMES = (30, 90)
"""Frames after which a period is judged: the first number if they are quiet, the second in any case."""
SETTLED_FRAMES = (5, 60)
"""Minimum frames after a start before a correction, and frames after which a phase that is still noisier than
a quarter of the tolerance is used nevertheless (2 s at 30 fps)."""
FRAMES_TO_ACT = 3
"""Frames needed to act: one at the expected time shows a moved phase, but one may be late by chance."""
FRAMES_TO_OUTVOTE, UNALIKE = 5, 4.0
"""Two frames may be late by chance, too. With fewer frames than the first number, the first frame after an
expected move may deviate from the others by at most the second number times the noise."""
JUDGED_STARTS_FRAMES = 10
"""Frames after a start that show whether its first frame was reliable."""
HOLD_NS = {
    PhaseControl.FRAME_DURATION: 0,
    PhaseControl.INJECTION: 2_000_000_000,
    PhaseControl.RESET: 10_000_000_000,
    PhaseControl.NONE: 2_000_000_000,
}
"""Target time in ns between two corrections; the setpoint centres the drift over it."""


def choose_actuator(
    camera: CameraFacts, *, rng: random.Random, profile: InjectionProfile | None, aimed: bool
) -> PhaseActuator:
    """Return the actuator for a camera's phase control.

    `profile` is the injection profile from earlier use, if any; `aimed=False` restarts at random times.
    """
    match camera.phase_control:
        case PhaseControl.INJECTION:
            return InjectionActuator(camera, profile)
        case PhaseControl.RESET:
            return ResetActuator(rng=rng, aimed=aimed)
        case PhaseControl.FRAME_DURATION:
            return FrameDurationActuator(camera)
        case PhaseControl.NONE:
            return PhaseActuator()


class AlignmentWindow:
    """Alignment check of one stream against the requested tolerance, or what its timestamps allow; in ns."""

    def __init__(self, asked_ns: int, phase_control: PhaseControl) -> None:
        self.asked_ns = asked_ns
        self.reachable_ns = 0
        """Smallest tolerance that the step of the timestamps allows; 0 if the steps are fine."""
        self.stay_ns = float("inf")
        """Time in which drift takes the stream across its tolerance, from one end to the other."""
        self.aligned = False
        """Whether the frames were within the requested tolerance at the last check."""
        self.within_window = False
        """Whether they were within the effective tolerance, which coarse timestamps may widen."""
        self._moves = phase_control in (PhaseControl.INJECTION, PhaseControl.FRAME_DURATION)
        """Whether moves reach their target; if not, each phase is random and is taken as measured."""
        self.landing_fraction = LANDING_FRACTION if phase_control is PhaseControl.INJECTION else 1.0
        """Fraction of the tolerance that counts as aligned; 1 after a first move, or if no move helps."""
        self._quantum_ns = self._hidden_ns = self._drift_ppm = 0.0

    @property
    def tolerance_ns(self) -> int:
        """Effective tolerance: the requested one, or what the timestamps allow if that is larger."""
        return max(self.asked_ns, self.reachable_ns)

    @property
    def inner_ns(self) -> int:
        """Limit for the measured error: effective tolerance less the error that coarse timestamps hide."""
        return self._inner_ns(self.tolerance_ns)

    @property
    def drifts_fast(self) -> bool:
        """Whether the stream leaves its tolerance too soon to be held within it."""
        return self.stay_ns < LONG_STAY_NS

    def clear(self) -> None:
        """Mark the stream as not aligned until the next check."""
        self.aligned = self.within_window = False

    def is_open(self, now: PhaseEstimate) -> bool:
        """Whether more frames may still show that the stream is within its window."""
        if not self._moves or self.within_window or now.frames >= PHASE_FRAMES:
            return False
        return abs(now.error_ns) < self.landing_fraction * self.inner_ns + 2.0 * now.sigma_ns

    def judge(self, now: PhaseEstimate) -> None:
        """Update the verdict on a settled stream from its present error."""
        self.aligned = abs(now.error_ns) <= self._limit_ns(self.aligned, self.asked_ns, now)
        self.within_window = abs(now.error_ns) <= self._limit_ns(self.within_window, self.tolerance_ns, now)

    def judge_unmoved(self, error_ns: float) -> None:
        """Update the verdict on a stream commanded to move but not moved yet: it can only lose alignment."""
        self.aligned = self.aligned and abs(error_ns) <= self._inner_ns(self.asked_ns)
        self.within_window = self.within_window and abs(error_ns) <= self.inner_ns

    def _limit_ns(self, before: bool, tolerance_ns: int, now: PhaseEstimate) -> float:
        inner_ns, two_sigma_ns = self._inner_ns(tolerance_ns), 2.0 * now.sigma_ns
        if self._hidden_ns > two_sigma_ns:
            return inner_ns - two_sigma_ns
        if self._moves and not before:
            return self.landing_fraction * inner_ns - two_sigma_ns
        # Noise alone should not end the alignment of a stream that can only be restarted.
        return inner_ns + min(two_sigma_ns, inner_ns / 2) if before and not self._moves else inner_ns

    def _inner_ns(self, tolerance_ns: int) -> int:
        return max(0, round(tolerance_ns - self._hidden_ns))

    def update(self, phase: PhaseEstimator, drift_ppm: float) -> None:
        """Update the limits from the estimate of a settled stream and its drift in us per second."""
        self._quantum_ns, self._drift_ppm = phase.quantum_ns, drift_ppm
        hidden_ns = self._hidden_ns = phase.quantum_error_ns
        if not hidden_ns:
            self.reachable_ns = 0
        elif not self.reachable_ns or phase.run_frames >= STEADY_FRAMES:
            # The hidden error limits both the measurement and the finest step by which a move can be aimed.
            aimed_ns = hidden_ns - phase.quantum_ns / 4
            reachable_ns = round(hidden_ns + aimed_ns + SIGMAS * phase.sigma_at(phase.last_ns))
            if not EASED * self.reachable_ns < reachable_ns <= self.reachable_ns:
                self.reachable_ns = reachable_ns
        self.stay_ns = 2e6 * self.tolerance_ns / max(abs(drift_ppm), 1e-3)

    @property
    def degradation(self) -> str:
        """Reason in plain words why the requested tolerance is not met; empty if it is."""
        if self.reachable_ns <= self.asked_ns:
            return ""
        return (
            f"its timestamps come in steps of {duration(self._quantum_ns)}: aligned to"
            f" ±{duration(self.reachable_ns)}, asked for ±{duration(self.asked_ns)}"
        )

    @property
    def fleetingness(self) -> str:
        """Note in plain words on how briefly the stream stays aligned; empty if it stays long."""
        if not self.drifts_fast:
            return ""
        return (
            f"drifts {duration(abs(self._drift_ppm) * 1000)} a second: within ±{duration(self.tolerance_ns)}"
            f" for {duration(self.stay_ns)} at a time, and brought there again for each burst"
        )


class Aligner:
    """Phase control of one camera's stream, with at most one command under way; times in ns."""

    def __init__(
        self,
        camera: CameraFacts,
        *,
        tolerance_ns: int,
        rng: random.Random,
        profile: InjectionProfile | None = None,
        aimed: bool = True,
    ) -> None:
        self.window = AlignmentWindow(tolerance_ns, camera.phase_control)
        """Tolerance that the stream can reach, and the time for which it stays within it."""
        self._hold_ns = HOLD_NS[camera.phase_control]
        self.phase = PhaseEstimator(period_ns=camera.period_ns)
        """The stream's period, phase, frames and drops."""
        self.actuator = choose_actuator(camera, rng=rng, profile=profile, aimed=aimed)
        """Means of moving the phase; its `profile` is what injections have shown about this device."""
        self.corrections = 0
        """Commands so far that moved the phase by more than a few rows."""
        self._pending: tuple[CameraCommand, int, int] | None = None
        """Command whose effect is awaited, the time it was issued, and the stream number at that time."""
        self._stream, self._first_frame_ns, self._start_learned = -1, 0, True
        self._min_frames = SETTLED_FRAMES[0]
        self.problem = ""
        """Reason in plain words why this camera can never be aligned; empty if it can."""
        self.other_rate = ""
        """Status text of a stream whose rate is not the rig's, so that it passes by its grid; else empty."""

    @property
    def settled(self) -> bool:
        """Whether period and phase are accurate enough to act on, and no move is under way."""
        phase = self.phase
        if self._pending or phase.disturbed or phase.frames < WARM_FRAMES[0]:
            return False
        blur_ns = phase.period_sigma_ns / phase.period_ns * self._hold_ns
        is_blurred = phase.frames < WARM_FRAMES[1] and blur_ns > self.window.tolerance_ns / 4
        return not is_blurred and self._run_settled

    @property
    def meets_bursts(self) -> bool:
        """Whether a stream that drifts too fast to be held is brought to its grid for each burst."""
        return self._pending is None and self.window.drifts_fast and self.actuator.meets_bursts

    @property
    def start_latencies_ns(self) -> tuple[int, ...]:
        """Observed start latencies modulo the period, newest last: input of `learn_start_latency`."""
        return tuple(round(latency * self.phase.period_ns) for latency in self.actuator.latencies)

    def learn_start_latency(self, latency_ns: int) -> None:
        """Add a start latency of this device from earlier use, in ns from the command to the first frame."""
        self.actuator.note_start(0, self.phase.period_ns)
        self.actuator.learn_start(latency_ns)

    def add_frame(self, stamp: FrameStamp) -> int:
        """Add a frame; return the number of frames dropped just before it."""
        dropped, phase = self.phase.add(stamp), self.phase
        if stamp.stream > self._stream:
            self._stream, self._first_frame_ns, self._start_learned = stamp.stream, stamp.timestamp_ns, False
        if self.actuator.restarts and phase.run_frames == JUDGED_STARTS_FRAMES and phase.known:
            # Nine of ten restarts miss: if a start's first frame is as good as five, do not wait for five.
            steady = phase.first_off_ns() < self.window.tolerance_ns / 4
            self._min_frames = 1 if steady else SETTLED_FRAMES[0]
        return dropped

    def note_stream_start(self, local_ns: int) -> None:
        """Record a start or restart of the stream at a local time; its next frame shows the latency."""
        self.window.clear()
        self.actuator.note_start(local_ns, self.phase.period_ns)

    def complete_command(self, now_local_ns: int) -> int:
        """End the command under way once its effect shows or is overdue, and learn from the effect.

        Return the shift by a command that has ended, in ns; 0 for none.
        """
        shift_ns = 0
        run_settled, phase = self._run_settled, self.phase
        if self._pending is not None:
            command, issued_ns, stream = self._pending
            if isinstance(command, RestartStream):
                done = self._stream > stream and run_settled
                overdue = now_local_ns - issued_ns > RESET_TIMEOUT_NS + command.delay_ns
            else:
                done = not phase.disturbed
                timeout_ns = INJECTION_TIMEOUT_NS + 2 * TIMEOUT_FRAMES * phase.period_ns
                overdue = now_local_ns - issued_ns > timeout_ns
            if not done and not overdue:
                return 0
            self._pending = None
            if overdue:
                return 0
            shift_ns = phase.last_shift_ns or 0
            self.actuator.learn(phase.last_shift_ns, phase.noise_ns, phase.last_latency_frames)
        if not self._start_learned and run_settled:
            self._start_learned = True
            self.actuator.learn_start(phase.nearest_frame_ns(self._first_frame_ns))
        return shift_ns

    def estimate(self, time_map: TimeMap, grid: FrameGrid, at_leader_ns: int) -> PhaseEstimate | None:
        """Return the stream's error at an instant of leader time; None if it is unknown."""
        phase = self.phase
        if phase.run_frames < self._frames_needed or not phase.known:
            return None
        frame_local_ns = phase.nearest_frame_ns(time_map.local_from_leader(at_leader_ns))
        period_ns = phase.period_ns * (1.0 + time_map.skew)
        return PhaseEstimate(
            error_ns=grid.phase_error(time_map.leader_from_local(frame_local_ns)),
            period_ns=round(period_ns),
            drift_ppm=(period_ns / grid.period_ns - 1.0) * 1e6,
            sigma_ns=phase.sigma_at(frame_local_ns),
            frames=phase.run_frames,
            at_leader_ns=at_leader_ns,
            quantum_error_ns=phase.quantum_error_ns,
        )

    def next_command(
        self,
        time_map: TimeMap,
        grid: FrameGrid,
        now_local_ns: int,
        *,
        hold: bool = False,
        burst_leader_ns: tuple[int, int] | None = None,
        is_recording: bool = False,
        common_instant_leader_ns: int | None = None,
    ) -> CameraCommand | None:
        """Judge the stream now, and return the command to carry out at once, if one is needed.

        `hold=True` starts no correction that is visible in images. `burst_leader_ns` holds the first and
        last instants of a burst. Injections with a known effect bring the stream to its grid for that burst,
        but no visible correction starts from shortly before the burst on, unless it is a recording that is
        under way (`is_recording`). A stream that can only be restarted
        is judged by its phase at `common_instant_leader_ns`, if that is in the future.
        """
        self.complete_command(now_local_ns)
        now = self._judge(time_map, grid, now_local_ns)
        if now is None or (self.phase.as_expected and self._frames_may_mislead(now.frames)):
            return None
        if self.window.is_open(now) and burst_leader_ns is None:
            return None
        drift = self._drift(now, now_local_ns)
        if is_recording:
            setpoint = self.actuator.setpoint_in_recording(drift)
        elif burst_leader_ns is not None:
            first_ns, last_ns = burst_leader_ns
            setpoint = self.actuator.setpoint_for_burst(
                drift, begins_ns=first_ns - now.at_leader_ns, lasts_ns=last_ns - first_ns
            )
        elif hold:
            setpoint = self.actuator.setpoint_on_hold(drift)
        else:
            common_instant_ns = max(0, (common_instant_leader_ns or now.at_leader_ns) - now.at_leader_ns)
            setpoint = self.actuator.setpoint(
                drift,
                hold_ns=self._hold_ns,
                aligned=self.window.within_window,
                common_instant_ns=common_instant_ns,
            )
        if setpoint is None:
            return None
        return self._command_towards(setpoint, drift, time_map, grid, now_local_ns)

    def _judge(self, time_map: TimeMap, grid: FrameGrid, now_local_ns: int) -> PhaseEstimate | None:
        """Update the verdict on the stream; return its error if the caller may act on it, else None."""
        now = self.estimate(time_map, grid, time_map.leader_from_local(now_local_ns))
        if now is None or not self.settled:
            if self.phase.unmoved and self.phase.known:
                frame_leader_ns = time_map.leader_from_local(self.phase.nearest_frame_ns(now_local_ns))
                self.window.judge_unmoved(grid.phase_error(frame_leader_ns))
            else:
                self.window.clear()
            return None
        self.problem, self.other_rate = self.actuator.problem, self._find_other_rate(now, grid)
        self.window.update(self.phase, now.drift_ppm)
        if self.problem or self.other_rate:
            self.window.clear()
            return None
        self.window.judge(now)
        return now

    def _drift(self, now: PhaseEstimate, now_local_ns: int) -> Drift:
        """Return the stream's error and drift, with the error limits below which no correction is made."""
        two_sigma_ns, inner_ns = 2.0 * now.sigma_ns, self.window.inner_ns
        within_window, landing_fraction = self.window.within_window, self.window.landing_fraction
        still_quantized = now.quantum_error_ns > two_sigma_ns and now.frames < QUANTIZED_FRAMES
        return Drift(
            now.error_ns + self.phase.shift_to_come(now_local_ns),
            now.drift_ppm * 1e-6,
            self.phase.period_ns,
            inner_ns,
            min(two_sigma_ns, self.window.tolerance_ns / 2) if within_window else 0.0,
            self.phase.shifts.latency_frames,
            inner_ns if within_window or still_quantized else landing_fraction * inner_ns - two_sigma_ns,
            landing_fraction,
        )

    def _command_towards(
        self, setpoint: Setpoint, drift: Drift, time_map: TimeMap, grid: FrameGrid, now_local_ns: int
    ) -> CameraCommand | None:
        """Return the command that moves the stream; None if no command improves it or one has to wait."""
        leader_ns = time_map.leader_from_local(round(now_local_ns + setpoint.lead_ns))
        instant_local_ns = time_map.local_from_leader(grid.instant(grid.index_of(leader_ns)))
        move = Move(
            now_local_ns=now_local_ns,
            target_local_ns=instant_local_ns + round(setpoint.target_ns),
            shift_ns=round((setpoint.target_ns - drift.error_after(setpoint.lead_ns)) % self.phase.period_ns),
            period_ns=self.phase.period_ns,
            tolerance_ns=round(drift.landing_fraction * self.window.inner_ns),
            off_centre_ns=setpoint.off_centre_ns,
        )
        command = self.actuator.command(move)
        if command is None or self.corrections:
            # An unknown device's first injection may land anywhere; the row step may be too coarse for more.
            self.window.landing_fraction = 1.0
        return command if command is not None and self._begin(command, now_local_ns) else None

    def _begin(self, command: CameraCommand, now_local_ns: int) -> bool:
        """Register a command with its expected effect. Return False if it must wait for a smaller one."""
        if (small_ns := self.actuator.small_shift_ns) is not None:
            self.phase.expect_shift(small_ns)
            return True
        if self.phase.shift_to_come(now_local_ns):
            return False
        self._pending = command, now_local_ns, self._stream
        self.corrections += 1
        if not isinstance(command, RestartStream):
            self.phase.mark_disturbance(self.actuator.expected_shift_ns)
        return True

    def _frames_may_mislead(self, frames: int) -> bool:
        """Whether the few frames since an expected move may be late by chance."""
        return frames < FRAMES_TO_ACT or (
            frames < FRAMES_TO_OUTVOTE
            and self.phase.first_off_ns() > max(UNALIKE * self.phase.noise_ns, 2_000.0)
        )

    @property
    def _frames_needed(self) -> int:
        """Frames since the last move needed to know the phase: one if it moved as expected."""
        return 1 if self.phase.as_expected else self._min_frames

    @property
    def _run_settled(self) -> bool:
        frames, phase = self.phase.run_frames, self.phase
        return frames >= self._frames_needed and (
            frames >= SETTLED_FRAMES[1] or phase.sigma_at(phase.last_ns) < self.window.tolerance_ns / 4
        )

    def _find_other_rate(self, now: PhaseEstimate, grid: FrameGrid) -> str:
        three_sigma_ppm = 3e6 * self.phase.period_sigma_ns / self.phase.period_ns
        if abs(now.drift_ppm) - three_sigma_ppm <= MAX_DRIFT_PPM:
            return ""
        own, rig = 1e9 / now.period_ns, 1e9 / grid.period_ns
        return (
            f"this camera runs at {own:.2f} frames/s and the rig at {rig:.2f}: each instant gets its nearest"
            f" frame, up to {duration(now.period_ns / 2)} off"
        )
