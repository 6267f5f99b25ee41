"""Bursts that a leader orders, with triggers that are repeated until they are acknowledged or expire."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from capture_app.common.camera_facts import PhaseControl
from capture_app.common.errors import BadInputError, NoCameraHereError
from capture_app.common.timeouts import TRIGGER_GIVE_UP_NS
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.phase.grid_phase_choice import CameraPhase
from capture_app.sync.phase.period_choice import MAX_DRIFT_PPM
from capture_app.sync.rig.events import TriggerAnswered
from capture_app.sync.rig.frame_selection import (
    MAX_BURST_NS,
    MAX_FRAMES,
    Burst,
    burst_instants,
    burst_limits,
    is_possible_burst,
)
from capture_app.sync.rig.roster import Member, Roster
from capture_app.sync.timekeeping.poll_schedule import AT_ONCE_NS, NEVER_NS
from capture_app.sync.wire.datagrams import Trigger, TriggerAck

TRIGGER_LEAD_NS = 500_000_000
"""Delay before a burst that is requested for now begins, so that every client receives its trigger first."""
TRIGGER_AGAIN_NS = 50_000_000
"""Interval of a trigger that is not acknowledged: ten repetitions fit into TRIGGER_LEAD_NS."""
AFTER_BURST_NS = 1_000_000_000
"""Time after a burst's last instant in which neither the grid nor a planned delay of up to
`stagger.MAX_DELAY_NS` may change: clients still select frames."""
MAX_LEAD_NS = 24 * 3_600_000_000_000
"""Maximum time between the order of a burst and its start, in the future or the past."""
NO_ANSWER = "it does not answer"
"""Reason reported for a client that has not answered a trigger within TRIGGER_GIVE_UP_NS."""
CANCELLED = "it was cancelled"
"""Client's answer to a trigger that cancels a burst."""


def peak_to_peak_ns(grid: FrameGrid, phases: Sequence[CameraPhase], at_leader_ns: int) -> float:
    """Return the predicted peak-to-peak time difference, in ns, of the frames nearest to a leader time."""
    errors = []
    for phase in phases:
        # A stream that is held by its frames' durations does not drift.
        ppm = 0.0 if phase.phase_control == PhaseControl.FRAME_DURATION else phase.drift_ppm
        if (frame_ns := phase.frame_leader_ns) is not None and abs(ppm) < MAX_DRIFT_PPM:
            errors.append(grid.phase_error(frame_ns) + ppm * 1e-6 * (at_leader_ns - frame_ns))
    return max(errors) - min(errors) if errors else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BurstOrder:
    """Request for a burst on the rig's grid."""

    frames: int
    spacing: int = 1
    """Number of periods between two instants."""
    spare: int = 0
    """Maximum number of extra instants that replace dropped frames; ignored for a streamed burst."""
    at_leader_ns: int | None = None
    """Start time, possibly in the past within the reach of the ring buffers; None: as soon as all can know of
    it."""
    number: int | None = None
    """Number of a new burst; None: the next number."""
    streamed: bool = False
    """Whether frames are sent as they arrive, instead of after the last one."""
    video: bool = False
    """Whether the frames become a video per camera."""
    without: Collection[str] = ()
    """Names of cameras that take no part."""


Key = tuple[int, int]
"""A burst's key: the run of the leader that ordered it, and its number there."""


@dataclass(slots=True)
class _OpenTrigger:
    """Trigger of a burst, and the members that have not answered it yet, by their numbers."""

    trigger: Trigger
    members: dict[int, Member]
    give_up_ns: int
    cancels: bool
    """Whether the trigger cancels the burst."""
    again: bool
    """Whether the clients have had the burst already: the trigger ends it earlier, or continues it."""
    due_ns: int = AT_ONCE_NS
    """Time at which the trigger is next sent to all of them."""


class Orders:
    """Triggers that are not answered yet; `now_ns` is leader time."""

    def __init__(self, leader: int, roster: Roster) -> None:
        """`leader` is the leader's instance number; `roster` holds the cameras that take bursts."""
        self._leader, self._roster = leader, roster
        self._open_bursts: dict[Key, _OpenTrigger] = {}
        self._bursts = 0
        self._busy_until_ns: dict[Key, int] = {}
        self._streamed: dict[Key, tuple[Trigger, frozenset[str], int]] = {}
        """Triggers of streamed bursts, their cameras and last instants."""

    def check(self, grid: FrameGrid | None, order: BurstOrder) -> FrameGrid:
        """Return the grid of a burst.

        Raises BadInputError for an impossible burst, NoCameraHereError without a camera to take it.
        """
        if grid is None or not self._cameras(order):
            raise NoCameraHereError("no camera is here", hint="start one: capture-app cameras add SPEC")
        if not is_possible_burst(order.frames, order.spacing * grid.period_ns, streamed=order.streamed):
            max_frames, max_ns = burst_limits(streamed=order.streamed)
            raise BadInputError(
                f"a burst of {order.frames} frames, every {order.spacing} periods, is not possible",
                hint=f"1 to {max_frames} frames, spacing 1 or more, {max_ns // 10**9} s at most",
            )
        return grid

    def place(self, grid: FrameGrid | None, now_ns: int, order: BurstOrder) -> Burst:
        """Order a burst of all cameras on the rig's grid. Raises as `check` does."""
        grid, cameras = self.check(grid, order), self._cameras(order)
        asked_ns = now_ns + TRIGGER_LEAD_NS if order.at_leader_ns is None else order.at_leader_ns
        if abs(asked_ns - now_ns) > MAX_LEAD_NS:
            raise BadInputError(
                f"a burst at {asked_ns} ns of the leader's clock, which shows {now_ns}, is not possible",
                hint=f"at most {MAX_LEAD_NS // 3_600_000_000_000} hours away; for later ones, start it then",
            )
        step_ns, frames, spare = order.spacing * grid.period_ns, order.frames, 0
        if not order.streamed:
            spare = max(0, min(order.spare, MAX_FRAMES - frames, MAX_BURST_NS // step_ns + 1 - frames))
        instants_ns = burst_instants(grid, asked_ns, frames + spare, order.spacing)
        number = self._bursts = self._bursts + 1 if order.number is None else order.number
        burst = Burst(
            number,
            instants_ns,
            grid.period_ns,
            asked_ns,
            tuple(member.name for member in cameras),
            spare,
            order.streamed,
            order.video,
        )
        self._open(burst, now_ns, step_ns, len(instants_ns))
        return burst

    def _cameras(self, order: BurstOrder) -> list[Member]:
        return [member for member in self._roster.cameras() if member.name not in order.without]

    def end(self, burst: Burst, frames: int, now_ns: int, *, run: int | None = None) -> Burst:
        """End a streamed burst after that many frames, and return the shortened burst.

        `run` is the run of the leader that ordered it, if that is an earlier one.
        """
        ended = replace(burst, instants_ns=burst.instants_ns[:frames])
        self._open(ended, now_ns, burst.step_ns, len(ended.instants_ns), again=True, run=run)
        return ended

    def resume(self, burst: Burst, run: int, now_ns: int) -> None:
        """Order the rest of a streamed burst of the leader's earlier `run`.

        It is ordered from the cameras that are ready, and later from those that become so.
        """
        self._open(burst, now_ns, burst.step_ns, len(burst.instants_ns), again=True, run=run)
        if (open_burst := self._open_bursts.get((run, burst.number))) is not None:
            members = open_burst.members
            for number in [
                number for number, member in members.items() if not member.report.state.is_aligned
            ]:
                self._close((run, burst.number), open_burst, number)

    def cancel(self, burst: Burst, now_ns: int) -> None:
        """Cancel a burst at the cameras that were to take it."""
        self._open(burst, now_ns, 0, 0)
        del self._busy_until_ns[self._leader, burst.number]

    def _open(
        self,
        burst: Burst,
        now_ns: int,
        step_ns: int,
        count: int,
        *,
        again: bool = False,
        run: int | None = None,
    ) -> None:
        """Start sending triggers to the burst's present cameras; they replace its earlier triggers."""
        first_ns, clients = burst.instants_ns[0], frozenset(burst.clients)
        key = leader, number = self._leader if run is None else run, burst.number
        kind = (burst.spare, burst.streamed, burst.video) if count else (0, False, False)
        root = 0 if leader == self._leader else self._leader
        trigger = Trigger(0, leader, number, first_ns, step_ns, count, *kind, root=root)
        members = {member.number: member for member in self._roster.cameras() if member.name in clients}
        self._open_bursts.pop(key, None)
        if trigger.streamed:
            self._streamed[key] = trigger, clients, burst.instants_ns[-1]
        else:
            self._streamed.pop(key, None)
        if members:
            self._open_bursts[key] = _OpenTrigger(
                trigger, members, now_ns + TRIGGER_GIVE_UP_NS, not count, again
            )
        self._busy_until_ns[key] = max(now_ns, burst.instants_ns[-1] + burst.period_ns) + AFTER_BURST_NS

    def is_busy(self, now_ns: int) -> bool:
        """Whether a burst is under way or ordered."""
        self._busy_until_ns = {burst: until for burst, until in self._busy_until_ns.items() if now_ns < until}
        return bool(self._busy_until_ns)

    def order_again(self, member: Member, now_ns: int) -> None:
        """Order what is being streamed from a member that is ready now: it may have been started again.

        Within a burst it could not align its stream.
        """
        self._streamed = {key: burst for key, burst in self._streamed.items() if now_ns < burst[2]}
        for key, (trigger, clients, _) in self._streamed.items():
            if member.name in clients:
                order = self._open_bursts.setdefault(
                    key, _OpenTrigger(trigger, {}, now_ns + TRIGGER_GIVE_UP_NS, cancels=False, again=True)
                )
                order.members[member.number], order.due_ns = member, AT_ONCE_NS

    def take_ack(self, member: Member, ack: TriggerAck) -> TriggerAnswered | None:
        """Record a member's answer; return None if it had already answered, or if the order has expired."""
        burst = self._open_bursts.get((ack.leader, ack.burst))
        if burst is None or member.number not in burst.members:
            return None
        # After a cancellation, an answer to the original trigger may still arrive.
        if burst.cancels and ack.refusal != CANCELLED:
            return None
        self._close((ack.leader, ack.burst), burst, member.number)
        return None if burst.cancels or burst.again else TriggerAnswered(member.name, ack.burst, ack.refusal)

    def expire(self, now_ns: int) -> list[TriggerAnswered]:
        """Drop and report the orders of members that are lost or exceed the answer timeout."""
        refused = []
        for key, burst in list(self._open_bursts.items()):
            if now_ns < min(burst.due_ns, burst.give_up_ns):
                continue
            for client, member in list(burst.members.items()):
                if member.lost or now_ns >= burst.give_up_ns:
                    self._close(key, burst, client)
                    if not burst.cancels and not burst.again:
                        why = member.lost or NO_ANSWER
                        refused.append(TriggerAnswered(member.name, key[1], why, is_silent=True))
        return refused

    def triggers_due(self, now_ns: int) -> list[tuple[Collection[Member], Trigger]]:
        """Return the triggers due now, first or repeated, without a client number, and their members."""
        due = [burst for burst in self._open_bursts.values() if now_ns >= burst.due_ns]
        for burst in due:
            burst.due_ns = now_ns + TRIGGER_AGAIN_NS
        return [(burst.members.values(), burst.trigger) for burst in due]

    def next_timer(self) -> int:
        """Leader time in ns at which the next trigger is due."""
        return min((burst.due_ns for burst in self._open_bursts.values()), default=NEVER_NS)

    def _close(self, key: Key, burst: _OpenTrigger, client: int) -> None:
        del burst.members[client]
        if not burst.members:
            del self._open_bursts[key]
