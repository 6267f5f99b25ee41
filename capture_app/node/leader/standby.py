"""Leaders of one rig by rank: the best one that is alive leads, and the others follow it as standbys."""

import asyncio
import contextlib
import ipaddress
import random
import secrets
import socket
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace

from capture_app.common.address import Address, own_hosts, resolve
from capture_app.common.clock import NodeClock
from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.names import name_like
from capture_app.common.node_state import NodeState
from capture_app.common.tasks import end
from capture_app.common.text import duration
from capture_app.net.asking import ask_all_nodes
from capture_app.net.channel import connect
from capture_app.net.server import bind_port
from capture_app.net.udp import client_socket
from capture_app.node.endpoint import Endpoint
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.messages import FromLeader
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.tree.succession import Succession
from capture_app.trust.sealed_engines import SealedClient

ASK_EVERY_S = 5.0
"""Interval between requests for the machines that the current leader knows, and for its cameras."""


@dataclass(frozen=True, slots=True)
class ContinuedClock:
    """Clock that continues a lost leader's time, by the time map from this machine's own clock."""

    own: NodeClock
    time_map: TimeMap

    def local_from_true(self, true_ns: int) -> int:
        """Return this clock's reading in ns at a true time in ns."""
        return self.time_map.leader_from_local(self.own.local_from_true(true_ns))

    def true_from_local(self, local_ns: int) -> int:
        """Return the true time in ns of a reading in ns, the inverse of `local_from_true`."""
        return self.own.true_from_local(self.time_map.local_from_leader(local_ns))

    def now_ns(self) -> int:
        """Return the current reading in ns."""
        return self.time_map.leader_from_local(self.own.now_ns())


class RankedLeader(Endpoint):
    """One of a rig's leaders: `run` leads when no better one does, else follows the current one."""

    def __init__(
        self,
        make_options: Callable[[], LeaderOptions],
        lead: Callable[[LeaderNode], Awaitable[None]],
        others: tuple[Address, ...],
        rank: int,
    ) -> None:
        """`make_options` returns fresh options each time it leads, by `lead`.

        `others` are in order of rank, and `rank` is the number of better ones. Raises NetworkError where the
        port is in use, because that must not surface only when it is needed.
        """
        self._make_options, self._lead, options = make_options, lead, make_options()
        for bound in bind_port(options.host, options.port):
            bound.close()
        self.cameras: tuple[str, ...] = ()
        """Present cameras of the current leader."""
        instance = secrets.randbits(32)
        name = name_like(f"leader-{socket.gethostname().split('.')[0]}-{options.port}", "leader")
        self._engine = engine = Succession(name, instance, others, rank, random.Random(secrets.randbits(64)))
        sealed = SealedClient(engine)
        super().__init__(options, engine, sealed, self._look)
        self._joining = self.join(engine.member, sealed.leader_keys, succession=engine)
        self._changed = asyncio.Event()
        self._serving: asyncio.Future[None] | None = None
        self._followed: tuple[str, int] | None = None

    async def run(self, sock: socket.socket) -> None:
        """Lead whenever this leader is to, until its `lead` returns or raises.

        `sock` is an unbound UDP socket.
        """
        asking = [asyncio.create_task(work) for work in (self._ask_whom(), self._joining.run())]
        self.pump.start(sock)
        try:
            while self._serving is None or not self._serving.done():
                if self._engine.leads and self._serving is None:
                    self._serving = asyncio.create_task(self._serve(self._taken_over()))
                    self._serving.add_done_callback(lambda _: self._changed.set())
                elif not self._engine.leads and self._serving is not None:
                    self.log.say(
                        "this one stops leading: a leader of higher rank leads, or it was frozen for too long"
                    )
                    await end(self._serving)
                    self._serving = None
                await self._changed.wait()
                self._changed.clear()
            await self._serving
        finally:
            await self.stop()
            await end(*asking, *([] if self._serving is None else [self._serving]))

    async def _serve(self, options: LeaderOptions) -> None:
        async with await LeaderNode.start(options) as node:
            await self._lead(node)

    def _look(self, _: int) -> None:
        if self._engine.leader not in (self._followed, None):
            self.log.say(f"{Address(*self._engine.leader)} leads: this one follows until that leader is lost")
        self._followed = self._engine.leader
        if self._engine.leads is not (self._serving is not None):
            self._changed.set()

    def _taken_over(self) -> LeaderOptions:
        """Return the options for leading from now on; they continue the lost leader's time if it is known."""
        options, continued = self._make_options(), self._engine.continued
        if continued is None:
            return options
        self.log.say(
            "the leader is lost: this one leads now, in the same time within"
            f" {duration(continued.upstream_map.uncertainty_ns)}"
        )
        return replace(
            options,
            clock=ContinuedClock(self._clock, continued.time_map),
            continued=continued,
            awaited=self.cameras,
        )

    async def _ask_whom(self) -> None:
        """Ask the current leader at intervals which cameras are there, and which machines it knows.

        The answer to the second question also has a datagram key.
        """
        while True:
            await asyncio.sleep(ASK_EVERY_S)
            if (leader := self._engine.leader) is None:
                continue
            self._joining.ask_again(leader)
            # Whether the leader is alive is noticed by its datagrams.
            with contextlib.suppress(SimulshotError):
                async with await connect(Address(*leader), FromLeader, trust=self._trust) as channel:
                    rig = await ask_all_nodes(channel)
                self.cameras = tuple(
                    camera.name for camera in rig.cameras if camera.state is not NodeState.LOST
                )


async def lead_by_rank(
    make_options: Callable[[], LeaderOptions],
    leaders: Sequence[Address],
    lead: Callable[[LeaderNode], Awaitable[None]],
) -> None:
    """Run `lead` whenever this machine is to lead among all `leaders` of a rig, given best first.

    Without others it leads at once. Raises BadInputError where this one is not among them, NetworkError where
    one has no address or the port is in use, and the errors of `lead`.
    """
    options = make_options()
    if len(leaders) < 2:
        async with await LeaderNode.start(options) as node:
            await lead(node)
        return
    addresses = [await resolve(leader) for leader in leaders]
    family = addresses[0][0]
    own = {*own_hosts(family), options.host}
    ranks = [
        rank
        for rank, (_, (host, port)) in enumerate(addresses)
        if port == options.port and (host in own or ipaddress.ip_address(host).is_loopback)
    ]
    if len(ranks) != 1 or any(address != family for address, _ in addresses):
        raise BadInputError(
            f"of {', '.join(map(str, leaders))} one must be this machine's, on port {options.port}",
            hint="give each of them the same list of all leaders, preferred first",
        )
    others = tuple(Address(*peer) for rank, (_, peer) in enumerate(addresses) if rank != ranks[0])
    await RankedLeader(make_options, lead, others, ranks[0]).run(client_socket(family))
