"""Keeps one camera's frames on the rig's grid: when to move the phase, how far, and when to let it be."""

import random
from dataclasses import dataclass

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.actuator import Move, MoveEffect
from capture_app.sync.phase.actuators import Controls, FrameLimits
from capture_app.sync.phase.aim import Aim, Course
from capture_app.sync.phase.estimator import FrameStamp, PhaseEstimate, PhaseEstimator
from capture_app.sync.phase.goal import Goal
from capture_app.sync.phase.injection import InjectionProfile
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream, SetFrameDuration

WARM_FRAMES = (30, 90)
"""A period is judged after that many frames if they are quiet, after that many in any case."""
SETTLED_FRAMES = (5, 60)
JUDGED_STARTS_FRAMES = 10
"""Once so many frames have come after a start, it shows whether the first one could have been believed."""
HOPELESS_PPM = 1000.0
INJECTION_TIMEOUT_NS = 5_000_000_000
RESET_TIMEOUT_NS = 15_000_000_000
DEFAULT_HOLD_NS = {
    "frame-duration": 0,
    "injection": 2_000_000_000,
    "reset": 10_000_000_000,
    "none": 2_000_000_000,
}


@dataclass(frozen=True, slots=True)
class _Outstanding:
    """A command under way."""

    command: CameraCommand
    issued_local_ns: int
    stream: int


class Aligner:
    """Watches one stream and gives at most one phase command at a time.

    `control` is "frame-duration", "injection", "reset" or "none"; `hold_ns` is how long a phase should last
    between two corrections: the aim is set so that the drift over it is centred. Times in ns.
    """

    def __init__(
        self,
        *,
        control: str,
        period_ns: int,
        tolerance_ns: int,
        row_time_ns: int | None = None,
        exposure_ns: int | None = None,
        min_exposure_ns: int | None = None,
        max_exposure_ns: int | None = None,
        min_frame_duration_ns: int | None = None,
        max_frame_duration_ns: int | None = None,
        rng: random.Random,
        hold_ns: int | None = None,
        profile: InjectionProfile | None = None,
        aimed: bool = True,
    ) -> None:
        self._tolerance_ns = tolerance_ns
        self._hold_ns = DEFAULT_HOLD_NS[control] if hold_ns is None else hold_ns
        self._phase = PhaseEstimator(period_ns=period_ns)
        limits = FrameLimits(
            period_ns,
            row_time_ns,
            exposure_ns,
            min_exposure_ns,
            max_exposure_ns,
            min_frame_duration_ns,
            max_frame_duration_ns,
        )
        self._controls = Controls(control, limits, rng=rng, profile=profile, aimed=aimed)
        self._controller = self._controls.controller
        self._injection, self._reset = self._controls.injection, self._controls.reset
        self._duration = self._controls.duration
        self._least_frames = SETTLED_FRAMES[0]
        self._outstanding: _Outstanding | None = None
        self._stream = -1
        self._start_seen = True
        self._started_ns = 0
        self.aligned = False
        """Whether the frames were within the tolerance at the last step."""
        self.corrections = 0
        self.problem = ""
        """Why this camera can never be held in step, in plain words; empty if it can."""

    @property
    def settled(self) -> bool:
        """Whether period and phase are known well enough to act on, and nothing is on the move."""
        phase = self._phase
        if self._outstanding is not None or phase.disturbed:
            return False
        if phase.frames < WARM_FRAMES[1]:
            blur_ns = phase.period_sigma_ns / phase.period_ns * self._hold_ns
            if phase.frames < WARM_FRAMES[0] or blur_ns > self._tolerance_ns / 4:
                return False
        return self._run_settled

    @property
    def frames(self) -> int:
        """Frames seen in all."""
        return self._phase.frames

    @property
    def drops(self) -> int:
        """Frames dropped in all."""
        return self._phase.drops

    @property
    def injection_profile(self) -> InjectionProfile | None:
        """What the injections have shown about this device."""
        return self._injection.profile if self._injection else None

    @property
    def start_latencies_ns(self) -> tuple[int, ...]:
        """Start latencies seen, modulo the period, newest last: for `learn_start_latency` at the next use."""
        if self._reset is None:
            return ()
        return tuple(round(latency * self._phase.period_ns) for latency in self._reset.latencies)

    def learn_start_latency(self, latency_ns: int) -> None:
        """Take in how long a start of this device took before, in ns from the command to the first frame."""
        if self._reset is not None:
            self._reset.started(0, self._phase.period_ns)
            self._reset.learn(MoveEffect(latency_ns, None, 0.0))

    def frame(self, stamp: FrameStamp) -> int:
        """Take a frame in; return how many were dropped just before it."""
        dropped = self._phase.add(stamp)
        if stamp.stream > self._stream:
            self._stream, self._start_seen = stamp.stream, False
            self._started_ns = stamp.timestamp_ns
        if self._reset is not None and self._phase.run_frames == JUDGED_STARTS_FRAMES and self._phase.known:
            # Nine of ten restarts fail: where a start's first frame tells as much, none waits for five.
            steady = self._phase.first_off_ns() < self._tolerance_ns / 4
            self._least_frames = 1 if steady else SETTLED_FRAMES[0]
        return dropped

    def outlier_ns(self, stamp_ns: int) -> int:
        """How far in ns a driver's timestamp lies off the line of its stream's frames, 0 within the noise."""
        return self._phase.outlier_ns(stamp_ns)

    def stream_started(self, local_ns: int) -> None:
        """The stream was started, or restarted, at a local time; its next frame shows the latency."""
        self.aligned = False
        if self._reset is not None:
            self._reset.started(local_ns, self._phase.period_ns)

    def settle_command(self, now_local_ns: int) -> None:
        """See whether the command under way is done, and learn from what it did."""
        under_way = self._outstanding
        if under_way is not None:
            waited_ns = now_local_ns - under_way.issued_local_ns
            if isinstance(under_way.command, RestartStream):
                done = self._stream > under_way.stream and self._run_settled
                late = waited_ns > RESET_TIMEOUT_NS + under_way.command.delay_ns
            else:
                done, late = not self._phase.disturbed, waited_ns > INJECTION_TIMEOUT_NS
            if not done and not late:
                return
            self._outstanding = None
            if late:
                return
            if self._injection is not None:
                shift_ns = self._phase.last_shift_ns
                self._injection.learn(MoveEffect(self._phase.last_ns, shift_ns, self._phase.noise_ns))
        if self._reset is not None and not self._start_seen and self._run_settled:
            self._start_seen = True
            self._reset.learn(MoveEffect(self._phase.nearest(self._started_ns), None, self._phase.noise_ns))

    def estimate(self, time_map: TimeMap, goal: Goal, at_leader_ns: int) -> PhaseEstimate | None:
        """The stream's error at an instant of leader time; None while nobody can tell."""
        phase = self._phase
        if phase.run_frames < self._least_frames or not phase.known:
            return None
        frame_local_ns = phase.nearest(time_map.local_from_leader(at_leader_ns))
        period_ns = phase.period_ns * (1.0 + time_map.skew)
        return PhaseEstimate(
            error_ns=goal.phase_error(time_map.leader_from_local(frame_local_ns)),
            period_ns=round(period_ns),
            drift_ppm=(period_ns / goal.period_ns - 1.0) * 1e6,
            sigma_ns=phase.sigma_at(frame_local_ns),
            frames=phase.run_frames,
            at_leader_ns=at_leader_ns,
        )

    def step(
        self,
        time_map: TimeMap,
        goal: Goal,
        now_local_ns: int,
        *,
        hold: bool = False,
        burst_leader_ns: tuple[int, int] | None = None,
        meeting_leader_ns: int | None = None,
    ) -> CameraCommand | None:
        """Judge the stream now, and return the command to carry out at once, if one is needed.

        `hold=True` begins no correction that shows in pictures. Nor does any from shortly before a burst
        on, whose first and last instants are `burst_leader_ns`; before that, injections whose effect is
        known bring the stream to its goal for that burst. A stream that can only be restarted is judged by
        its phase at `meeting_leader_ns`, if that is still to come.
        """
        self.settle_command(now_local_ns)
        now_leader_ns = time_map.leader_from_local(now_local_ns)
        now = self.estimate(time_map, goal, now_leader_ns)
        if now is None or not self.settled:
            self.aligned = False
            return None
        self.problem = self._find_problem(now, goal)
        # A phase at the very edge must not flicker in and out with its noise.
        grace_ns = min(2.0 * now.sigma_ns, self._tolerance_ns / 2) if self.aligned else 0.0
        self.aligned = not self.problem and abs(now.error_ns) <= self._tolerance_ns + grace_ns
        if self.problem or self._controller is None:
            return None
        course = Course(
            now.error_ns + self._phase.shift_to_come(now_local_ns),
            now.drift_ppm * 1e-6,
            self._tolerance_ns,
            grace_ns,
        )
        aim = self._aim(course, now_leader_ns, hold, burst_leader_ns, meeting_leader_ns)
        if aim is None:
            return None
        landing_local_ns = now_local_ns + aim.lead_ns
        move = Move(
            now_local_ns=now_local_ns,
            wanted_local_ns=self._wanted(time_map, goal, landing_local_ns) + round(aim.wanted_ns),
            shift_ns=round((aim.wanted_ns - aim.error_ns) % self._phase.period_ns),
            period_ns=self._phase.period_ns,
            tolerance_ns=self._tolerance_ns,
            aim_ns=aim.off_centre_ns,
        )
        return self._give(self._controller.command(move), now_local_ns)

    def _aim(
        self,
        course: Course,
        now_leader_ns: int,
        hold: bool,
        burst_leader_ns: tuple[int, int] | None,
        meeting_leader_ns: int | None,
    ) -> Aim | None:
        period_ns = self._phase.period_ns
        if burst_leader_ns is not None:
            first_ns, last_ns = burst_leader_ns
            return self._controls.aim_before(
                course, period_ns=period_ns, begins_ns=first_ns - now_leader_ns, lasts_ns=last_ns - first_ns
            )
        if hold:
            return self._controls.aim_on_hold(course, period_ns=period_ns)
        return self._controls.aim(
            course,
            period_ns=period_ns,
            hold_ns=self._hold_ns,
            aligned=self.aligned,
            agreed_ns=0 if meeting_leader_ns is None else max(0, meeting_leader_ns - now_leader_ns),
        )

    def _give(self, command: CameraCommand | None, now_local_ns: int) -> CameraCommand | None:
        """Remember what is expected of a command, and pass it on."""
        if command is None:
            return None
        if isinstance(command, SetFrameDuration) and self._duration is not None:
            if abs(self._duration.shift_ns) <= self._duration.fine_ns:
                self._phase.expect_shift(self._duration.shift_ns)
                return command
            if self._phase.shift_to_come(now_local_ns):
                return None
        self._outstanding = _Outstanding(command, now_local_ns, self._stream)
        self.corrections += 1
        self.aligned = False
        if not isinstance(command, RestartStream):
            self._phase.mark_disturbance()
        return command

    @property
    def _run_settled(self) -> bool:
        frames = self._phase.run_frames
        if frames < self._least_frames:
            return False
        sigma_ns = self._phase.sigma_at(self._phase.last_ns)
        return frames >= SETTLED_FRAMES[1] or sigma_ns < self._tolerance_ns / 4

    def _wanted(self, time_map: TimeMap, goal: Goal, local_ns: float) -> int:
        """Local time of the goal's instant nearest to a local time."""
        leader_ns = time_map.leader_from_local(round(local_ns))
        return time_map.local_from_leader(goal.instant(goal.index_of(leader_ns)))

    def _find_problem(self, now: PhaseEstimate, goal: Goal) -> str:
        doubt_ppm = 3e6 * self._phase.period_sigma_ns / self._phase.period_ns
        if abs(now.drift_ppm) - doubt_ppm > HOPELESS_PPM:
            return (
                f"this camera runs at {1e9 / now.period_ns:.3f} frames/s and the rig at"
                f" {1e9 / goal.period_ns:.3f}, too different to align"
            )
        return self._controller.problem if self._controller else ""
