"""Whether a stream is to be moved, and to where: drift is met half-way, or where a moment counts."""

from dataclasses import dataclass

LARGEST_AIM = 0.6
"""Most that drift is met half-way, as a share of the tolerance."""
MEND_SHARE = 0.25
"""What a burst would be off by more than this share of the tolerance is mended before it."""


@dataclass(frozen=True, slots=True)
class Course:
    """A stream's error now and its drift: ns, and ns per ns."""

    error_ns: float
    drift: float
    tolerance_ns: int
    grace_ns: float
    """What it may be off over its tolerance: a phase at the very edge must not flicker in and out."""

    def after(self, ns: float) -> float:
        """Error in ns after so much time, if nothing moves the stream."""
        return self.error_ns + self.drift * ns

    def is_in(self, error_ns: float) -> bool:
        """Whether an error can be left as it is."""
        return abs(error_ns) <= self.tolerance_ns + self.grace_ns


@dataclass(frozen=True, slots=True)
class Aim:
    """A wish for a move that counts `lead_ns` from now; times and errors in ns."""

    lead_ns: float
    error_ns: float
    """What the error will be then without the move."""
    wanted_ns: float
    """What it should be then."""
    off_centre_ns: float
    """How much of the tolerance the wish itself takes."""


def to_stay(course: Course, lead_ns: float, hold_ns: int) -> Aim:
    """Where a stream stays within its tolerance for longest: drift takes it through the middle."""
    furthest_ns = LARGEST_AIM * course.tolerance_ns
    wanted_ns = min(max(-course.drift * hold_ns / 2, -furthest_ns), furthest_ns)
    return Aim(lead_ns, course.after(lead_ns), wanted_ns, wanted_ns)


def to_meet(course: Course, lead_ns: float, ahead_ns: float) -> Aim | None:
    """Where drift takes a stream to its goal at a moment to come; None if it will be there anyhow."""
    if course.is_in(course.after(ahead_ns)):
        return None
    return Aim(lead_ns, course.after(lead_ns), -course.drift * (ahead_ns - lead_ns), 0.0)


def to_burst(
    course: Course, lead_ns: float, ready_ns: float, begins_ns: float, lasts_ns: float
) -> Aim | None:
    """Where drift takes a stream to its goal in the middle of a burst.

    None if the burst begins before `ready_ns`, when no long frame is on its way any more, or if there is
    little to mend.
    """
    middle_ns = begins_ns + lasts_ns / 2
    if begins_ns < ready_ns or abs(course.after(middle_ns)) <= MEND_SHARE * course.tolerance_ns:
        return None
    return Aim(lead_ns, course.after(lead_ns), -course.drift * (middle_ns - lead_ns), 0.0)
