"""Readiness of a rig for a burst, and the one sentence that names what prevents it."""

import asyncio
import math
from collections import Counter
from collections.abc import AsyncGenerator, Mapping, Sequence
from pathlib import Path

from capture_app.common.camera_facts import SIMULATED, CameraFacts, unmeasured_stamps
from capture_app.common.errors import DiskFullError, IncompleteError
from capture_app.common.node_state import NodeState
from capture_app.common.text import count, duration, megabytes
from capture_app.common.timeouts import DEGRADED_WAIT_S
from capture_app.net.channel import MAX_PAYLOAD_BYTES
from capture_app.node.leader.snapshots import present_cameras
from capture_app.protocol.event_text import off_rate_line
from capture_app.protocol.messages import SpoolSpace
from capture_app.protocol.status import REPORT_LOST_NS
from capture_app.session.files.disk import SPARE_BYTES, free_bytes
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.rig.burst_orders import peak_to_peak_ns
from capture_app.sync.rig.leader_engine import Leader
from capture_app.sync.rig.roster import Member, camera_phases
from capture_app.sync.timekeeping.rates import HostOffRate, RateVote

CHECK_EVERY_S = 0.1
GUESSED_PIXELS_PER_BYTE = 4
"""Pixels per byte of JPEG that a camera is assumed to have before its first image."""
GUESSED_PIXELS_PER_BYTE_OF_TRUTH = 2
MARGIN = 1.1
_UNAVAILABLE = (NodeState.FAILED, NodeState.LOST)
_IN_PROGRESS = (
    NodeState.JOINING,
    NodeState.SYNCING,
    NodeState.ALIGNING,
    NodeState.DEGRADED,
)
"""If several nodes are not ready, the sentence names the one that waits longest for a person."""
_CLOCK_IS_KNOWN = (NodeState.ALIGNING, NodeState.DEGRADED, NodeState.READY)


def shortfall(member: Member, *, why: bool = False) -> str:
    """Return why a node is not ready: its state, with its own message if `why`, or its degradation."""
    state, message = member.report.state, member.report.message
    if state is NodeState.DEGRADED:
        return f"{member.camera.called(member.name)}: {message}"
    return f"{member.camera.called(member.name)} is {state}" + (f": {message}" if why and message else "")


def degraded_nodes(members: Sequence[Member]) -> str:
    """Return the nodes that are synchronized less accurately than requested; empty if none is."""
    return ", ".join(shortfall(member) for member in members if member.report.state is NodeState.DEGRADED)


def drift_apart(grid: FrameGrid, members: Sequence[Member], begins_ns: int, lasts_ns: int) -> str:
    """Return how far cameras will drift apart in a recording, if farther than they tolerate; else empty.

    It begins at `begins_ns` of leader time. No stream is moved while frames of a burst are selected.
    """
    phases = camera_phases(members)
    spread_ns = peak_to_peak_ns(grid, phases, begins_ns + lasts_ns)
    if spread_ns <= 2 * max((phase.tolerance_ns for phase in phases), default=0):
        return ""
    return (
        f"the cameras will drift apart by {duration(spread_ns)} within {duration(lasts_ns)}:"
        " their phases are not corrected during a recording"
    )


def why_not_ready(members: Sequence[Member], cameras: int, *, accept_degraded: bool = False) -> str:
    """Return why the rig, of at least `cameras` cameras, is not ready; empty when it is."""
    enough = (NodeState.LOST, NodeState.READY, *([NodeState.DEGRADED] if accept_degraded else []))
    late = [shortfall(member) for member in members if member.report.state not in enough]
    if (there := len(present_cameras(members))) < cameras:
        late.append(f"{there} of {cameras} nodes have joined")
    return ", ".join(late)


async def reasons_until_ready(engine: Leader, timeout_s: float, cameras: int) -> AsyncGenerator[str, None]:
    """Yield why the rig is not ready, until it is as ready as it will be.

    Nodes that are merely less accurate than requested are accepted after DEGRADED_WAIT_S, as more time hardly
    helps them. Raises IncompleteError where others are not ready within `timeout_s`.
    """
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + timeout_s
    usable_s: float | None = None
    while reason := why_not_ready(engine.roster.by_name(), cameras):
        now_s = loop.time()
        if why_not_ready(engine.roster.by_name(), cameras, accept_degraded=True):
            usable_s = None
            if now_s >= deadline_s:
                raise IncompleteError(
                    f"not ready after {timeout_s:g} s: {reason}",
                    hint="capture-app status says why; without --wait-s the burst is taken at once",
                )
        else:
            usable_s = now_s if usable_s is None else usable_s
            if now_s >= min(deadline_s, usable_s + DEGRADED_WAIT_S):
                return
        yield reason
        # States change with a node's report, which is no event.
        await asyncio.sleep(CHECK_EVERY_S)


def _guessed_bytes(camera: CameraFacts) -> int:
    pixels = camera.width * camera.height
    truth = pixels // GUESSED_PIXELS_PER_BYTE_OF_TRUTH if camera.kind == SIMULATED else 0
    # A camera that claims to be huge must not make every burst too large.
    return min(MAX_PAYLOAD_BYTES, pixels // GUESSED_PIXELS_PER_BYTE + truth)


def check_room(
    root: Path,
    cameras: Sequence[Member],
    known: Mapping[str, int],
    frames: int,
    spools: Mapping[str, SpoolSpace],
) -> dict[str, str]:
    """Check that a burst of `frames` of each camera fits; `known` are mean image sizes from earlier images.

    Return the cameras to leave out, with the reason: those of machines that need more than their share of the
    disk, and those without room in their spool. Raises DiskFullError where that concerns most machines.
    """
    needed = {
        camera.name: int(MARGIN * frames * (known.get(camera.name) or _guessed_bytes(camera.camera)))
        for camera in cameras
    }
    free = free_bytes(root)
    # What a machine only claims takes no room from what others are known to need.
    without, left = _over_share(
        [camera for camera in cameras if camera.name in known], needed, free - SPARE_BYTES
    )
    without |= _over_share([camera for camera in cameras if camera.name not in known], needed, left)[0]
    if 2 * len({_machine(camera) for camera in cameras if camera.name in without}) > len(
        {*map(_machine, cameras)}
    ):
        raise DiskFullError(
            f"the burst may need {megabytes(sum(needed.values()) + SPARE_BYTES)}"
            f" and {root} has {megabytes(free)} free",
            hint="make room, or take fewer frames",
        )
    for name in sorted((needed.keys() - without.keys()) & spools.keys()):
        if needed[name] > (spool := spools[name]).free_bytes:
            without[name] = (
                f"it may need {megabytes(needed[name])},"
                f" and has {megabytes(spool.free_bytes)} free in its {spool.spool}"
            )
    return without


def _over_share(
    cameras: Sequence[Member], needed: Mapping[str, int], room: int
) -> tuple[dict[str, str], int]:
    """Return the cameras of machines that need more than an equal share of `room`, and the room left.

    Machines that need less than their share leave the rest to the others (max-min fairness).
    """
    by_machine: Counter[str] = Counter()
    for member in cameras:
        by_machine[_machine(member)] += needed[member.name]
    ascending = sorted(by_machine.items(), key=lambda item: item[1])
    for place, (_, size) in enumerate(ascending):
        share = max(0, room) // (len(ascending) - place)
        if size > share:
            over = dict(ascending[place:])
            return {
                member.name: f"its machine may need {megabytes(over[_machine(member)])},"
                f" and its share of the leader's disk is {megabytes(share)}"
                for member in cameras
                if _machine(member) in over
            }, room
        room -= size
    return {}, room


def _machine(member: Member) -> str:
    """Return the machine whose share a camera takes: by its pin, in an open rig by its address."""
    return member.pin or member.address[0]


def review_rates(vote: RateVote, members: Sequence[Member]) -> list[HostOffRate]:
    """Compare the rates of all clocks by their nodes' reports; return changes of the verdict."""
    known = [member for member in members if member.report.state in _CLOCK_IS_KNOWN]
    # A reported skew is the rate of the leader's clock relative to the node's.
    rates_ppm = {
        member.name: -member.report.skew_ppm for member in known if member.report.skew_ppm is not None
    }
    return vote.review(rates_ppm)


def rig_advice(
    members: Sequence[Member],
    leader: str,
    now_ns: int,
    off_rate: Mapping[str | None, HostOffRate] | None = None,
) -> str:
    """Return one sentence of advice; `leader` is where nodes join, `off_rate` are hosts with odd clocks."""
    sentence = _of_states(members, _UNAVAILABLE, now_ns)
    if not sentence and off_rate:
        worst = max(off_rate.values(), key=lambda off: abs(off.fast_ppm))
        sentence = off_rate_line(
            worst, lambda name: next((m.camera.called(name) for m in members if m.name == name), name)
        ) + _and_more(len(off_rate))
    if sentence := sentence or _of_states(members, _IN_PROGRESS, now_ns):
        return sentence
    cameras = present_cameras(members)
    if not cameras:
        return f"no camera has joined: start one with capture-app node --leader {leader} --camera SPEC"
    if waiting := [member for member in cameras if member.report.uploads_wait]:
        return shortfall(waiting[0], why=True) + _and_more(len(waiting))
    bars_ns = [member.report.uncertainty_ns for member in cameras if member.report.uncertainty_ns is not None]
    sure = f", clock error ≤ {duration(max(bars_ns))} (95 %)" if bars_ns else ""
    facts = {member.name: member.camera for member in cameras}
    if unsure := unmeasured_stamps(facts):
        sure += f"; {unsure}"
    elif stamps_ns := max(camera_facts.stamp_accuracy.uncertainty_ns for camera_facts in facts.values()):
        sure += f", timestamp error ≤ {duration(stamps_ns)}"
    return f"{count(len(cameras), 'camera')} ready{sure}"


def _of_states(members: Sequence[Member], states: Sequence[NodeState], now_ns: int) -> str:
    for state in states:
        since_ns = now_ns - REPORT_LOST_NS if state is NodeState.LOST else -math.inf
        concerned = [m for m in members if m.report.state is state and m.last_heard_ns >= since_ns]
        if concerned:
            return shortfall(concerned[0], why=True) + _and_more(len(concerned))
    return ""


def _and_more(all_of_them: int) -> str:
    return "" if all_of_them == 1 else f" (and {count(all_of_them - 1, 'more node')})"
