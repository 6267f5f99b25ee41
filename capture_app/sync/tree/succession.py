"""Which of a rig's ranked leaders leads: the first that is alive; the others follow its clock meanwhile.

None is taken back: a leader that returns follows the one that leads, whatever its rank, as every change costs
the bursts under way (VRRP without preemption, RFC 9568). Where two lead, as after a split network, the one
of the worse rank gives way.
"""

import random
from dataclasses import dataclass

from msgspec.structs import replace

from capture_app.common.node_state import RELAY
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.engine import Address
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.wire.messages import CLOCK, UpstreamMap

HEARTBEAT_EVERY_NS, SILENT_NS = 100_000_000, 600_000_000
"""Six of them unanswered, and the leader is gone: before its nodes ask who follows it."""
AGAIN_NS = 300_000_000
"""One that is gone is asked once more for so long."""
FIRST_NS, EACH_BETTER_NS = 2_000_000_000, 500_000_000
"""At first, for each other one and each better one; later, for each better one that is there."""
STANDBY = replace(CLOCK, kind=RELAY, model="standby: leads when this leader is gone")
"""How it describes itself to the one that leads: it must be missed within seconds."""


@dataclass(frozen=True, slots=True)
class Continued:
    """What one that begins to lead takes over from the leader that is gone."""

    time_map: TimeMap
    """From its own clock to that one's."""
    told: UpstreamMap
    """What its members are told of that: how far its time may be from that one's."""
    grid: FrameGrid


class Succession:
    """One of a rig's ranked leaders: keeps asking the others; `now_ns` is its own clock, whoever leads.

    Whoever runs it serves as a leader while `leads`, in the time of `continued`.
    """

    def __init__(
        self, name: str, instance: int, leaders: tuple[Address, ...], rank: int, rng: random.Random
    ) -> None:
        """`leaders` are the other ones, the best first, of which `rank` are better than this one.

        `name` is what it is called while it follows.
        """
        self.leads = False
        """Whether it is the one that leads."""
        self.continued: Continued | None = None
        """What it took over when it began to lead; None where it knew no time."""
        self.member = TreeMember(
            name, instance, leaders, rng, STANDBY, heartbeat_every_ns=HEARTBEAT_EVERY_NS, silent_ns=SILENT_NS
        )
        """Its membership of the one that leads."""
        self._leaders, self._rank = leaders, rank
        self._followed: int | None = None
        """Which of the others it followed last."""
        self._lead_ns: int | None = None
        """When it begins to lead unless another one answers; None while one does, or it leads."""

    @property
    def leader(self) -> Address | None:
        """The one that is followed, None where there is none or it leads itself."""
        return self.member.parent if self.member.time.is_member and not self.leads else None

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in a datagram of one of the others that arrived at `now_ns`."""
        self.member.receive_datagram(data, address, now_ns)
        self._look(now_ns)

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        self.member.handle_timer(now_ns)
        self._look(now_ns)

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` wants to be called."""
        due_ns = self.member.next_timer()
        return due_ns if self._lead_ns is None else min(due_ns, self._lead_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams and where to; a time request carries `now_ns`, so send them at once."""
        return self.member.datagrams_to_send(now_ns)

    def _look(self, now_ns: int) -> None:
        """See who leads."""
        other = self._leaders.index(self.member.parent)
        if self.member.time.is_member:
            self.leads = self.leads and other >= self._rank
            if not self.leads:
                self._followed, self._lead_ns = other, None
        elif not self.leads and self._lead_ns is None:
            wait_ns = FIRST_NS * (len(self._leaders) + self._rank)
            if self._followed is not None:
                # Better ones that have followed, too, come first.
                wait_ns = AGAIN_NS + EACH_BETTER_NS * (self._rank - (self._followed < self._rank))
            self._lead_ns = now_ns + wait_ns
        if self._lead_ns is not None and now_ns >= self._lead_ns:
            self.leads, self._lead_ns = True, None
            self.continued = self._take_over(now_ns)

    def _take_over(self, now_ns: int) -> Continued | None:
        """Return what is known of the time and the grid of the leader that is gone."""
        keeper, followed = self.member.time.timekeeper, self.member.time.followed
        time_map = keeper.time_map
        if followed is None or time_map is None or not keeper.time_is_known:
            return None
        told = UpstreamMap(
            path=keeper.path[:1],
            epoch_local_ns=time_map.leader_from_local(now_ns),
            offset_ns=0,
            skew=0.0,
            uncertainty_ns=time_map.uncertainty_at(now_ns),
            hard_bound_ns=time_map.hard_bound_at(now_ns),
            skew_uncertainty=time_map.skew_uncertainty
            + time_map.drift_uncertainty * (now_ns - time_map.epoch_local_ns),
            skew_bound=time_map.skew_bound,
            drift_uncertainty=time_map.drift_uncertainty,
        )
        grid = FrameGrid(followed.anchor_leader_ns, followed.period_ns)
        return Continued(time_map, told, grid)
