"""Moves a camera's phase by known commands, and finds its rows in what they do."""

from math import sqrt

from msgspec.structs import replace

from capture_app.camera_facts import CameraFacts, PhaseControl
from capture_app.node.characterization.character import Moves
from capture_app.node.characterization.common_step import LEAST_SHIFTS, common_step
from capture_app.node.characterization.stream_watch import PLACE_FRAMES, StreamWatch
from capture_app.sync.phase.injection import FIRST_STRETCH_NS, INSIDE_ROW, InjectionActuator, InjectionHistory
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, SetFrameDuration

MOVES = 20
STRETCHES_NS = tuple(37_000 * number + 1_900 * number**2 for number in range(MOVES))
"""What frames are stretched by beyond the first stretch: no two differences are alike."""


async def measure_moves(watch: StreamWatch, facts: CameraFacts, moves: int) -> Moves | None:
    """Give so many commands, and find what they do; None where this camera has no such command.

    Raises CameraError where the camera refuses one, or gives no frames any more.
    """
    if facts.phase_control is PhaseControl.INJECTION:
        problem = _injections(facts).problem
        if problem:
            return Moves(commands=0, effective=0, reason=problem)
    elif facts.phase_control is not PhaseControl.FRAME_DURATION:
        return None
    history = InjectionHistory(period_ns=facts.period_ns, row_time_ns=facts.row_time_ns)
    shifts_ns: list[float] = []
    latencies: list[int] = []
    for number, stretch_ns in enumerate(STRETCHES_NS[:moves]):
        command, rows = _command(facts, number, stretch_ns, history)
        shift_ns, latency = await watch.shift(command)
        if latency is None:
            continue
        shifts_ns.append(shift_ns)
        latencies.append(latency)
        history.add(rows, shift_ns / history.row_ns, watch.phase.noise_ns / history.row_ns)
    step_ns = common_step(shifts_ns, watch.phase.noise_ns * sqrt(2.0 / PLACE_FRAMES))
    seen = Moves(
        commands=min(moves, MOVES),
        effective=len(shifts_ns),
        latency_frames=(min(latencies), max(latencies)) if latencies else None,
        step_ns=step_ns,
        reason=_reason(len(shifts_ns), step_ns),
    )
    return _with_rows(seen, facts, history)


def _command(
    facts: CameraFacts, number: int, stretch_ns: int, history: InjectionHistory
) -> tuple[CameraCommand, int]:
    """A command that lengthens one frame, and the rows that it exposes, or lasts, for."""
    wanted_ns = facts.period_ns + FIRST_STRETCH_NS + stretch_ns
    rows = round(wanted_ns / history.row_ns)
    # Now even and now odd: shifts by even rows alone would look like those of rows twice as long.
    rows += (rows + number) % 2
    asked_ns = round((rows + INSIDE_ROW) * history.row_ns)
    if facts.phase_control is PhaseControl.INJECTION:
        return InjectFrame(min(asked_ns, facts.max_exposure_ns or asked_ns)), rows
    return SetFrameDuration(min(asked_ns, facts.max_frame_duration_ns or asked_ns)), rows


def _with_rows(seen: Moves, facts: CameraFacts, history: InjectionHistory) -> Moves:
    """The same, with what the step and the injections say of rows."""
    if facts.phase_control is PhaseControl.FRAME_DURATION:
        return replace(seen, row_time_ns=seen.step_ns)
    if not history.moved:
        return seen
    profile = history.fit()
    row_ns = None if seen.step_ns is None else seen.step_ns / profile.gain
    overhead_ns = facts.period_ns - profile.neutral_rows * profile.row_time_ns
    return replace(seen, row_time_ns=row_ns, injection=profile, overhead_ns=overhead_ns)


def _reason(effective: int, step_ns: float | None) -> str:
    if not effective:
        return "no command moved its phase"
    if effective < LEAST_SHIFTS:
        return f"too few moves for rows to show: {LEAST_SHIFTS} are needed"
    return "" if step_ns is not None else "its stamps scatter too much for rows to show in its shifts"


def _injections(facts: CameraFacts) -> InjectionActuator:
    return InjectionActuator(
        period_ns=facts.period_ns,
        row_time_ns=facts.row_time_ns,
        min_exposure_ns=facts.min_exposure_ns,
        max_exposure_ns=facts.max_exposure_ns,
    )
