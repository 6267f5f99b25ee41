"""What a camera's phase can be moved by, if by anything, and when a move of that kind is worth it."""

import random
from dataclasses import dataclass

from capture_app.sync.phase.actuator import PhaseActuator
from capture_app.sync.phase.aim import Aim, Course, to_burst, to_meet, to_stay
from capture_app.sync.phase.frame_duration import FrameDurationActuator
from capture_app.sync.phase.injection import InjectionActuator, InjectionProfile
from capture_app.sync.phase.reset import ResetActuator

INJECTION_LEAD_FRAMES = 9
"""From the command until the phase is known again: 2-4 frames of latency, the long ones, five calm ones."""
BURST_LEAD_FRAMES = 12
"""From the command to a burst: four of latency, three long ones in the time of six, two to spare."""
STEP_LEAD_FRAMES = 5
"""From the command until a frame of another duration counts."""
RESET_LEAD_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class FrameLimits:
    """What is known of a camera's rows, exposures and frame durations; times in ns."""

    period_ns: int
    row_time_ns: int | None = None
    exposure_ns: int | None = None
    min_exposure_ns: int | None = None
    max_exposure_ns: int | None = None
    min_frame_duration_ns: int | None = None
    max_frame_duration_ns: int | None = None


class Controls:
    """One of three controllers, or none: `control` is "frame-duration", "injection", "reset" or "none"."""

    def __init__(
        self,
        control: str,
        limits: FrameLimits,
        *,
        rng: random.Random,
        profile: InjectionProfile | None,
        aimed: bool,
    ) -> None:
        self.injection: InjectionActuator | None = None
        self.reset: ResetActuator | None = None
        self.duration: FrameDurationActuator | None = None
        if control == "injection":
            self.injection = InjectionActuator(
                period_ns=limits.period_ns,
                row_time_ns=limits.row_time_ns,
                min_exposure_ns=max(limits.min_exposure_ns or 0, limits.exposure_ns or 0),
                max_exposure_ns=limits.max_exposure_ns,
                profile=profile,
            )
        elif control == "reset":
            self.reset = ResetActuator(rng=rng, aimed=aimed)
        elif control == "frame-duration":
            self.duration = FrameDurationActuator(
                period_ns=limits.period_ns,
                row_time_ns=limits.row_time_ns,
                min_duration_ns=limits.min_frame_duration_ns,
                max_duration_ns=limits.max_frame_duration_ns,
            )
        self.controller: PhaseActuator | None = self.injection or self.reset or self.duration

    def lead_ns(self, period_ns: float) -> float:
        """Time in ns from a command until it counts."""
        if self.reset is not None:
            return RESET_LEAD_NS
        return (STEP_LEAD_FRAMES if self.duration else INJECTION_LEAD_FRAMES) * period_ns

    def aim(
        self, course: Course, *, period_ns: float, hold_ns: int, aligned: bool, agreed_ns: int
    ) -> Aim | None:
        """Where the stream should be moved to stay; None if nothing is to be done.

        A stream that can only be restarted is judged by where it will be in `agreed_ns`, if that is not 0.
        """
        lead_ns = self.lead_ns(period_ns)
        if self.duration is not None:
            return Aim(lead_ns, course.after(lead_ns), 0.0, 0.0)
        if self.reset is not None:
            if agreed_ns > 0:
                return to_meet(course, lead_ns, agreed_ns)
            return None if aligned else to_stay(course, lead_ns, hold_ns)
        if course.is_in(course.after(lead_ns)):
            return None
        return to_stay(course, lead_ns, hold_ns)

    def aim_on_hold(self, course: Course, *, period_ns: float) -> Aim | None:
        """Where the stream should be moved while nothing may show in pictures: by a few rows at most."""
        if self.duration is None:
            return None
        lead_ns = self.lead_ns(period_ns)
        error_ns = course.after(lead_ns)
        return None if abs(error_ns) > self.duration.fine_ns else Aim(lead_ns, error_ns, 0.0, 0.0)

    def aim_before(self, course: Course, *, period_ns: float, begins_ns: int, lasts_ns: int) -> Aim | None:
        """Where the stream should be moved for a burst that begins so much later, and lasts so long."""
        if self.injection is None or not self.injection.sure:
            return self.aim_on_hold(course, period_ns=period_ns)
        ready_ns = BURST_LEAD_FRAMES * period_ns
        return to_burst(course, self.lead_ns(period_ns), ready_ns, begins_ns, lasts_ns)
