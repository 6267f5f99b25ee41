"""The one sentence with which a node says why it is not ready, and what a person can do about it."""

from capture_app.sync.clock.clock_filter import ASYMMETRY_SHARE
from capture_app.sync.phase.frame_stamp import PhaseEstimate
from capture_app.sync.timekeeping.accuracy_goal import CLOCK_SHARE
from capture_app.text import count, duration

NO_ANSWER = "no leader has answered: is it running, and does its firewall let UDP through?"
REMEDY_MARGIN = 1.2
"""The tolerance that is suggested is so many times what would do now: the next minute may be worse."""


def syncing(samples: int, needed: int, error_ns: float | None, wanted_ns: float | None) -> str:
    """Say how far the clock is: answers of the leader, or its 95 % error and the one asked for, in ns."""
    if samples < needed or error_ns is None or wanted_ns is None:
        return f"{samples} of {needed} answers of the leader"
    return f"clock sure to ±{duration(error_ns)} so far, asked for ±{duration(wanted_ns)}"


def coarse(error_ns: float, wanted_ns: float, round_trip_ns: int, *, by_relay: bool) -> str:
    """Say that a clock's 95 % error is larger than asked for, why, and what would help; times in ns.

    `by_relay`: the relay that is followed knows the time no better.
    """
    if by_relay:
        why, remedy = "its relay knows the time no better", "bring the relay nearer to the leader"
    elif 2.0 * ASYMMETRY_SHARE * round_trip_ns / 2.0 > wanted_ns:
        # Messages cannot tell how a round trip is shared between there and back, however many there are.
        why, remedy = f"round trip of {duration(round_trip_ns)}", "a shorter way to the leader"
    else:
        why, remedy = "bursty link", "nearer the access point, a cable"
    enough = f"--tolerance-us {_rounded_up(REMEDY_MARGIN * error_ns / CLOCK_SHARE / 1000.0)}"
    return (
        f"clock sure to ±{duration(error_ns)} only, asked for ±{duration(wanted_ns)}:"
        f" {why}; {remedy}, or {enough}"
    )


def aligning(phase: PhaseEstimate | None, *, settled: bool, corrections: int, waits: bool) -> str:
    """Say what a stream that is not aligned yet is about: `waits` for a restart that suits all cameras."""
    if phase is None:
        after = f", again after {count(corrections, 'correction')}" if corrections else ""
        return f"learning when the camera takes its frames{after}"
    off = f"frames {duration(abs(phase.error_ns))} off the rig's instants"
    if waits:
        return f"{off}: waits for a restart that suits all cameras"
    after = f" after {count(corrections, 'correction')}" if corrections else ""
    return f"{off}: moving them{after}" if settled else f"{off}: measuring{after}"


def off_grid(phase: PhaseEstimate | None, tolerance_ns: int) -> str:
    """Say that a camera which cannot be moved lies off the grid; empty where it is near enough."""
    if phase is None or abs(phase.error_ns) <= tolerance_ns:
        return ""
    return f"this camera cannot move its frames, {duration(abs(phase.error_ns))} off the rig's instants"


def _rounded_up(us: float) -> int:
    """Return a number with one digit that is not zero, no less than this one."""
    unit = 1
    while us > 10 * unit:
        unit *= 10
    return -(-round(us + 0.5) // unit) * unit
