"""Status texts of nodes: one sentence on why a node is not ready, and what its operator can do."""

from msgspec.structs import replace

from capture_app.common.node_state import NodeState
from capture_app.common.text import count, duration
from capture_app.sync.clock.likely_line import ASYMMETRY
from capture_app.sync.clock.time_map import SIGMAS_95
from capture_app.sync.phase.aligner import Aligner
from capture_app.sync.phase.estimator import PhaseEstimate
from capture_app.sync.timekeeping.rates import RateWatch
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.datagrams import Report

RATE_CHANGED = (
    "its clock's rate against the leader's has just changed: an NTP daemon is slewing one of the two,"
    " so wait for half a minute, or stop it while you take pictures"
)
"""Status text within RECENT_NS after a rate change."""
REMEDY_MARGIN = 1.5
"""Ratio of the suggested tolerance to the current error: the next minute may be worse."""
MEASURE = "capture-app cameras calibrate-time --panel"
"""Command that measures a path's asymmetry."""
NETWORK_NS = 200_000
"""Shortest round-trip delay of a wireless network; a shorter one is within a machine, or over one cable."""


def of_state(
    state: NodeState,
    keeper: Timekeeper,
    aligner: Aligner,
    phase: PhaseEstimate | None,
    now_ns: int,
    *,
    can_move: bool,
    waits: bool,
) -> str:
    """Return the status text of a client in that state; empty if there is nothing to report.

    `can_move`: its stream can be moved at all; `waits`: it must not be moved yet, because of other cameras.
    """
    target_ns, time_map = keeper.target.target_ns, keeper.time_map
    error_ns = keeper.target.error_ns
    match state:
        case NodeState.JOINING:
            return "asks to join"
        case NodeState.SYNCING:
            return syncing(keeper.clock.samples, keeper.schedule.min_samples, error_ns, target_ns)
        case NodeState.ALIGNING | NodeState.DEGRADED | NodeState.READY if odd := rate(keeper.rate, now_ns):
            return odd
        case NodeState.ALIGNING if keeper.target.met or time_map is None:
            return aligning(phase, settled=aligner.settled, corrections=aligner.corrections, waits=waits)
        case NodeState.DEGRADED if keeper.target.met:
            return aligner.window.degradation
        case NodeState.ALIGNING | NodeState.DEGRADED if (
            time_map is not None and error_ns is not None and target_ns is not None
        ):
            # With such a clock frames are aligned repeatedly: the clock is the cause in both states.
            own = keeper.map_to_leader
            is_below = len(keeper.path) > 1
            by_relay = is_below and own is not None and own.uncertainty_at(now_ns) <= target_ns
            longer_ns = 0.0 if by_relay else keeper.clock.longer_ns
            return degraded(error_ns, target_ns, time_map.round_trip_ns, longer_ns, by_relay=by_relay)
        case NodeState.READY if not can_move:
            return aligner.other_rate or off_grid(phase, aligner.window.asked_ns)
        case NodeState.READY:
            return aligner.window.fleetingness
    return ""


def syncing(samples: int, needed: int, error_ns: float | None, target_ns: float | None) -> str:
    """Describe the progress of the clock: samples counted, or its 95 % error and the requested one, in ns."""
    if samples < needed or error_ns is None or target_ns is None:
        return f"measuring clock {samples}/{needed}"
    return f"clock error ≤ {duration(error_ns)} so far, target {duration(target_ns)}"


def degraded(
    error_ns: float, target_ns: float, round_trip_ns: int, longer_ns: float = 0.0, *, by_relay: bool
) -> str:
    """Describe why a clock's 95 % error exceeds the requested one, and the remedy; times in ns.

    `longer_ns` of the error are due to an increased path delay. `by_relay`: the relay that is followed has a
    clock that is no more accurate.
    """
    # Messages cannot show how a round-trip delay divides between its two directions, however many there are.
    unseen_ns = SIGMAS_95 * ASYMMETRY * round_trip_ns / 2.0
    remedy = "nearer the access point, a cable, or "
    if by_relay:
        why, remedy = "its relay's clock is no more accurate", "bring the relay nearer to the leader, or "
    elif longer_ns > error_ns / 2.0:
        why = (
            f"the round trip to the leader grew by {duration(2.0 * longer_ns)}: network load, or a worse path"
        )
    elif target_ns < unseen_ns and error_ns < 2.0 * unseen_ns:
        why = (
            f"even its fastest messages have a round trip of {duration(round_trip_ns)},"
            " and none shows how it divides between the two directions"
        )
        remedy = f"nearer the access point, a cable, a panel ({MEASURE}), or "
    else:
        why = "bursty link"
    if round_trip_ns < NETWORK_NS and not by_relay:
        why, remedy = f"messages with a round trip of {duration(round_trip_ns)} are delayed at times", "use "
    enough = f"--clock-tolerance-us {_rounded_up(REMEDY_MARGIN * error_ns / 1000.0)}"
    return f"clock error ≤ {duration(error_ns)}, target {duration(target_ns)}: {why}; {remedy}{enough}"


def rate(watch: RateWatch, now_ns: int) -> str:
    """Describe an unusual rate of this node's clock against the leader's; empty if none."""
    if watch.fast_ppm is not None:
        return fast_clock(watch.fast_ppm)
    return RATE_CHANGED if watch.changed_lately(now_ns) else ""


def fast_clock(ppm: float) -> str:
    """Describe a node's clock that runs `ppm` faster than the leader's."""
    return (
        f"its clock runs {fast_or_slow(ppm)} against the leader's:"
        " an NTP daemon is slewing one of the two, or one is a virtual machine"
    )


def fast_or_slow(ppm: float) -> str:
    """Format a rate: 210 ppm fast."""
    return f"{abs(ppm):.0f} ppm {'fast' if ppm > 0 else 'slow'}"


def aligning(phase: PhaseEstimate | None, *, settled: bool, corrections: int, waits: bool) -> str:
    """Describe the progress of a stream's alignment; `waits` for a restart that suits all cameras."""
    after = f" after {count(corrections, 'correction')}" if corrections else ""
    if phase is None:
        return f"learning when the camera takes its frames{', again' if corrections else ''}{after}"
    off = f"frames {duration(abs(phase.error_ns))} off the rig's instants"
    if waits:
        return f"{off}: waits for a restart that suits all cameras"
    return f"{off}: moving them{after}" if settled else f"{off}: measuring{after}"


def off_grid(phase: PhaseEstimate | None, tolerance_ns: int) -> str:
    """Describe the offset of an immovable camera from the grid; empty if within the tolerance."""
    if phase is None or abs(phase.error_ns) <= tolerance_ns:
        return ""
    return f"this camera cannot move its frames, {duration(abs(phase.error_ns))} off the rig's instants"


def jumped(report: Report, jump_ns: float) -> Report:
    """Return a camera's report that says that its phase jumped, and that a ready camera is degraded by it."""
    state = NodeState.DEGRADED if report.state is NodeState.READY else report.state
    message = (
        f"its frame times jumped by {duration(jump_ns)} without a restart, so the rig's instants do not"
        " follow this camera: check its clock and its cable"
    )
    return replace(report, state=state, message=message)


def _rounded_up(us: float) -> int:
    """Round up to 1, 2, 5, 10, 20 …, so that the result is constant while an estimate varies."""
    unit = 1
    while us > 10 * unit:
        unit *= 10
    return next(step * unit for step in (1, 2, 5, 10) if us <= step * unit)
