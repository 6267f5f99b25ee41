"""Succession of a rig's ranked leaders: the first live one leads, and the others follow its clock meanwhile.

There is no preemption. A leader that returns follows the active one, whatever its rank, as every change of
leader costs the bursts under way (VRRP without preemption, RFC 9568). A frozen leader whose members did not
wait counts as returned. If two lead, as after a split network, the one of lower rank gives way.
"""

import random
from dataclasses import dataclass

from msgspec.structs import replace

from capture_app.common.node_state import RELAY
from capture_app.common.timeouts import LEADER_SILENT_NS
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.poll_schedule import NEVER_NS
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.wire.datagrams import CLOCK, UpstreamMap

HEARTBEAT_EVERY_NS, SILENT_NS = 100_000_000, 600_000_000
"""Heartbeat interval and timeout: six missed heartbeats, shorter than its nodes' own timeout."""
AGAIN_NS = 300_000_000
"""Time for which a lost leader is asked once more."""
FIRST_NS, EACH_BETTER_NS = 2_000_000_000, 500_000_000
"""Waiting times before leading. At first per other leader and per better one; later per live better one."""
AWAKE_NS = 500_000_000
"""Interval at which an active leader looks at its clock, to notice that it was frozen."""
YIELD_NS = 2 * SILENT_NS
"""Time for which a leader follows a better one before it gives way: one that was frozen stops meanwhile."""
STANDBY = replace(CLOCK, kind=RELAY, model="standby: leads when this leader is gone")
"""Description of a standby to the active leader: a member whose loss must be noticed within seconds."""


@dataclass(frozen=True, slots=True)
class Continued:
    """State that a new leader takes over from a lost one."""

    time_map: TimeMap
    """Map from the new leader's clock to the lost one's."""
    upstream_map: UpstreamMap
    """Message form for its members, with the uncertainty of its time against the lost leader's."""
    grid: FrameGrid


class Succession:
    """One of a rig's ranked leaders, which keeps probing the others; `now_ns` is always its own clock.

    While `leads` is set, the caller serves as a leader, in the time of `continued`.
    """

    def __init__(
        self, name: str, instance: int, leaders: tuple[Address, ...], rank: int, rng: random.Random
    ) -> None:
        """`leaders` are the other leaders, the best first; the first `rank` of them are better than this one.

        `name` is its name while it follows.
        """
        self.leads = False
        """Whether it is the active leader."""
        self.continued: Continued | None = None
        """State taken over when it began to lead; None if it knew no time."""
        self.member = TreeMember(
            name, instance, leaders, rng, STANDBY, heartbeat_every_ns=HEARTBEAT_EVERY_NS, silent_ns=SILENT_NS
        )
        """Its membership of the active leader."""
        self._leaders, self._rank = leaders, rank
        self._followed: int | None = None
        """Index in `leaders` of the one followed last."""
        self._change_ns: int | None = None
        """Time at which it begins to lead, or gives way; None if neither is pending."""
        self._called_ns = NEVER_NS
        """Time of the last call."""

    @property
    def leader(self) -> Address | None:
        """Address of the leader that is followed; None if there is none or if it leads itself."""
        return self.member.leader if self.member.time.is_member and not self.leads else None

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Process a datagram from one of the other leaders that arrived at `now_ns`."""
        self._note_absence(now_ns)
        self.member.receive_datagram(data, address, now_ns)
        self._look(now_ns)

    def handle_timer(self, now_ns: int) -> None:
        """Run the actions that are due; call it at `next_timer`, or at any time."""
        self._note_absence(now_ns)
        self.member.handle_timer(now_ns)
        self._look(now_ns)

    def next_timer(self) -> int:
        """Return the local time in ns at which `handle_timer` is to be called."""
        due_ns = self.member.next_timer()
        if self.leads:
            due_ns = min(due_ns, self._called_ns + AWAKE_NS)
        return due_ns if self._change_ns is None else min(due_ns, self._change_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams with their destinations; a time request carries `now_ns`, so send them at once."""
        return self.member.datagrams_to_send(now_ns)

    def leave(self) -> None:
        """Say goodbye to the active leader, as this one is about to stop."""
        self.member.leave()

    def _note_absence(self, now_ns: int) -> None:
        """Stop leading after a pause, as of a suspended machine, in which the members have left."""
        if self.leads and now_ns > self._called_ns + LEADER_SILENT_NS:
            self.leads, self._followed, self._change_ns = False, None, None
        self._called_ns = now_ns

    def _look(self, now_ns: int) -> None:
        """Update which leader is active."""
        other = self._leaders.index(self.member.leader)
        if not self.member.time.is_member:
            if self.leads:
                self._change_ns = None
            elif self._change_ns is None:
                wait_ns = FIRST_NS * (len(self._leaders) + self._rank)
                if self._followed is not None:
                    # Better leaders that also followed come first.
                    wait_ns = AGAIN_NS + EACH_BETTER_NS * (self._rank - (self._followed < self._rank))
                self._change_ns = now_ns + wait_ns
        elif not self.leads:
            self._followed, self._change_ns = other, None
        elif other >= self._rank:
            self._change_ns = None
        elif self._change_ns is None:
            self._change_ns = now_ns + YIELD_NS
        if self._change_ns is not None and now_ns >= self._change_ns:
            self.leads, self._change_ns = not self.leads, None
            if self.leads:
                self.continued = self._take_over(now_ns)

    def _take_over(self, now_ns: int) -> Continued | None:
        """Return the time and grid of the lost leader; None if its time is unknown."""
        keeper, followed = self.member.time.timekeeper, self.member.time.followed
        time_map = keeper.time_map
        if followed is None or time_map is None or not keeper.time_is_known:
            return None
        upstream_map = UpstreamMap(
            path=keeper.path[:1],
            epoch_local_ns=time_map.leader_from_local(now_ns),
            offset_ns=0,
            skew=0.0,
            uncertainty_ns=time_map.uncertainty_at(now_ns),
            hard_bound_ns=time_map.hard_bound_at(now_ns),
            skew_uncertainty=time_map.skew_uncertainty_after(now_ns - time_map.epoch_local_ns),
            skew_bound=time_map.skew_bound,
            drift_uncertainty=time_map.drift_uncertainty,
        )
        return Continued(time_map, upstream_map, FrameGrid(followed.anchor_leader_ns, followed.period_ns))
