"""A relay: a follower of its parent, and a leader to its own clients, who thereby hold the root's time.

Its time replies carry its own clock, which never jumps, however its estimate moves; how that clock stands
to the root's goes beside them, error budget included, and each client adds the two.
"""

import random
from dataclasses import replace

from capture_app.sync.agreement import Agreement
from capture_app.sync.events import LeaderEvent
from capture_app.sync.follower import Address, Follower, FollowerConfig, FollowerEvent
from capture_app.sync.leader import Leader, LeaderConfig
from capture_app.sync.onward import onward


class Relay:
    """Both state machines behind one socket; `now_ns` is the relay's own clock.

    Nobody is taken in before the root's time is known. `leader.instance` is the follower's.
    """

    def __init__(self, config: FollowerConfig, leader: LeaderConfig, rng: random.Random) -> None:
        self.follower = Follower(config, rng)
        self.leader = Leader(replace(leader, instance=config.instance), rng)
        self._parents = frozenset(config.parents)

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`, of a parent or of a client."""
        if address in self._parents:
            self.follower.receive_datagram(data, address, now_ns)
            self._pass_on()
        elif self.leader.onward is not None:
            self.leader.receive_datagram(data, address, now_ns)

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        self.follower.handle_timer(now_ns)
        self._pass_on()
        self.leader.handle_timer(now_ns)

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` wants to be called."""
        follower_ns, leader_ns = self.follower.next_timer(), self.leader.next_timer()
        return follower_ns if leader_ns is None else min(follower_ns, leader_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams and where to; time messages carry `now_ns`, so send them at once."""
        return self.leader.datagrams_to_send(now_ns) + self.follower.datagrams_to_send(now_ns)

    def next_event(self) -> FollowerEvent | LeaderEvent | None:
        """Return the next thing that happened on either side, None where there is none."""
        return self.follower.next_event() or self.leader.next_event()

    def _pass_on(self) -> None:
        """Tell the clients how this clock stands to the root's, and the root's grid of instants."""
        follower, leader = self.follower, self.leader
        if follower.time_map is None or follower.goal is None:
            return
        if leader.onward is None or leader.onward.epoch_local_ns != follower.time_map.epoch_local_ns:
            leader.onward = onward(follower.path, follower.time_map)
        if leader.goal != follower.goal:
            leader.agreement = Agreement(follower.goal)
