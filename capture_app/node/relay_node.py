"""A relay: it leads its own nodes in its leader's time, and forwards streams between them and the leader."""

import asyncio
import random
import secrets
from collections.abc import Sequence
from socket import socket
from typing import Any, Self

from capture_app.common.address import ANY_HOST, Address, own_hosts, resolve
from capture_app.common.errors import (
    BadInputError,
    DiskError,
    NetworkError,
    TryAgainError,
    UnknownMachineError,
)
from capture_app.common.tasks import end
from capture_app.common.text import duration
from capture_app.common.timeouts import UPSTREAM_TIMEOUT_S
from capture_app.net.channel import Channel, connect
from capture_app.net.server import bind_port
from capture_app.node.endpoint import PortEndpoint, PortOptions
from capture_app.node.enrolment import Asked, is_node
from capture_app.node.leader.readiness import rig_advice
from capture_app.node.leader.snapshots import fitted, node_statuses, page_of
from capture_app.protocol.event_text import relay_line
from capture_app.protocol.messages import (
    FromLeader,
    NodeStream,
    Refusal,
    StatusAnswer,
    StatusRequest,
    ToLeader,
)
from capture_app.protocol.pairing_messages import SpeaksFor
from capture_app.protocol.permissions import check_allowed
from capture_app.protocol.status import RigStatus
from capture_app.sync.rig.events import Joined, LeaderNotice
from capture_app.sync.rig.leader_engine import LeaderConfig
from capture_app.sync.rig.time_client import TimeClientEvent
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.tree.relay_engine import OF_CAMERAS, Relay
from capture_app.trust.sealed_engines import SealedRelay
from capture_app.trust.trust import ANYBODY


class RelayNode(PortEndpoint):
    """A running relay; `async with await RelayNode.start(...)` serves until the block ends.

    Streams of its nodes are forwarded to the leader byte by byte, through any number of relays. An image is
    safe when the root says so. A stream that breaks off is resumed between the node and the root.
    """

    def __init__(
        self,
        name: str,
        parents: Sequence[Address],
        options: PortOptions,
        engine: Relay,
        bound: tuple[socket, socket],
    ) -> None:
        """Assemble the parts for a bound port; call `start` instead."""
        sealed = SealedRelay(engine)
        super().__init__(options, engine, sealed, bound, self._drain)
        self._joining = self.join(engine.member, sealed.leader_keys, parents, is_relay=True)
        self.name, self.options, self._engine = name, options, engine
        self.log.title_of = engine.leader.roster.title
        # The relay cannot know which of its networks its nodes are on.
        hosts = own_hosts(bound[1].family) if options.host in ANY_HOST else []
        self.also = tuple(Address(other, self.address.port) for other in hosts if other != self.address.host)
        """Further addresses of this machine at which nodes may join."""
        self._upstream: Address | None = None
        self._upstream_channels: set[Channel[Any]] = set()
        self._lost_ns: int | None = None
        self._tasks: list[asyncio.Task[None]] = []

    @classmethod
    async def start(cls, name: str, parents: Sequence[Address], options: PortOptions) -> Self:
        """Bind, and join the parents: leaders or relays of one rig, tried in turn, best first.

        Raises NetworkError where the port is in use, or a parent's host has no address or none reachable from
        the host to listen on; DiskError or BadInputError where this machine's key is not available.
        """
        options.trust.server_context()
        addresses = [await resolve(parent) for parent in parents]
        bound = bind_port(options.host, options.port)
        if any(family != bound[0].family for family, _ in addresses):
            for sock in bound:
                sock.close()
            raise NetworkError(
                f"{Address(options.host, options.port)} and a leader's address mix IPv4 and IPv6",
                hint="listen on an address of the leader's kind with --host",
            )
        peers = tuple((peer.host, peer.port) for _, peer in addresses)
        instance, rng = secrets.randbits(32), random.Random(secrets.randbits(64))
        engine = Relay(
            TreeMember(name, instance, peers, rng, OF_CAMERAS),
            LeaderConfig(instance, transfer_port=bound[1].getsockname()[1]),
            rng,
        )
        relay = cls(name, parents, options, engine, bound)
        await relay.start_serving(relay._serve)
        relay._tasks = [asyncio.create_task(relay._joining.run())]
        return relay

    async def stop(self) -> None:
        """Sign off from the leader, send the nodes on to others, and close the port."""
        await end(*self._tasks)
        await super().stop()

    def status(self, after: str = "") -> RigStatus:
        """Return the relay's own status: a page of its nodes, and the state of its time."""
        return fitted(lambda nodes: self._page(after, nodes))

    def _page(self, after: str, max_nodes: int) -> RigStatus:
        now_ns = self._clock.now_ns()
        member, leader = self._engine.member, self._engine.leader
        time_map, nodes = member.time.time_map, leader.roster.by_name()
        message = self._holdover_message(now_ns)
        page, further, words = page_of(nodes, after, max_nodes)
        return RigStatus(
            leader=str(self.address),
            is_open=self.options.trust.is_open,
            relay=self.name,
            message="; ".join(filter(None, (message, words))),
            further=further,
            advice=message or rig_advice(nodes, str(self.address), now_ns),
            now_ns=now_ns if time_map is None else time_map.leader_from_local(now_ns),
            period_ns=None if leader.grid is None else leader.grid.period_ns,
            nodes=node_statuses(page, nodes, now_ns=now_ns),
        )

    # Streams

    async def _serve(self, below: Channel[ToLeader]) -> None:
        while (message := await below.receive_header()) is not None:
            try:
                check_allowed(below.who, message)
                match message:
                    case _ if isinstance(message, Asked):
                        await self.enrolment.answer(below, message)
                    case NodeStream() if not is_node(
                        below.who, self._engine.leader.roster.members.get(message.camera), message.instance
                    ):
                        raise TryAgainError(f"no node has joined as {message.camera} by this stream's key")
                    case _:
                        if await self._pass_on(below, message):
                            return
            except (UnknownMachineError, BadInputError, DiskError) as error:
                await below.send(Refusal.of_error(error))
            if below.who.is_unknown:
                return

    async def _pass_on(self, below: Channel[ToLeader], message: ToLeader) -> bool:
        """Forward a stream to the leader until it ends, from this message on; False without a leader."""
        try:
            if self._upstream is None:
                raise NetworkError(
                    self._holdover_message(self._clock.now_ns()),
                    hint="on the relay's machine: capture-app doctor --leader HOST",
                )
            above = await connect(
                self._upstream, FromLeader, timeout_s=UPSTREAM_TIMEOUT_S, trust=self.options.trust
            )
        except NetworkError as error:
            # A status is available without a leader; everything else has to wait.
            if isinstance(message, StatusRequest):
                await below.send(StatusAnswer(rig=self.status(message.after)))
            else:
                await below.send(Refusal.of_error(error))
            return False
        self._upstream_channels.add(above)
        try:
            async with above:
                if below.who is not ANYBODY:
                    who = below.who
                    node = (message.camera, message.instance) if isinstance(message, NodeStream) else None
                    await above.send(
                        SpeaksFor(pin=who.pin, name=who.name, roles=tuple(sorted(who.roles)), node=node)
                    )
                # No first message of a stream has a payload; it is read, and not kept.
                async for _ in below.payload():
                    pass
                await above.send(message)
                await below.relay(above)
        finally:
            self._upstream_channels.discard(above)
        return True

    # Events

    def _drain(self, _: int) -> None:
        while (event := self._engine.next_event()) is not None:
            if isinstance(event, Joined):
                self._change_upstream(Address(self._engine.member.leader[0], event.transfer_port))
            elif isinstance(event, LeaderNotice) and event.what == "lost":
                self._change_upstream(None)
            if not isinstance(event, TimeClientEvent):
                self.options.log.note(event)
            elif line := relay_line(event, Address(*self._engine.member.leader)):
                self.options.log.say(line)

    def _change_upstream(self, upstream: Address | None) -> None:
        """Switch to another parent, or none: abort the streams to the previous one, for nodes to resume."""
        self._upstream = upstream
        self._lost_ns = self._clock.now_ns() if upstream is None else None
        for above in self._upstream_channels:
            above.abort()

    def _holdover_message(self, now_ns: int) -> str:
        """Return the relay's state without a leader, as a sentence; empty while it has one."""
        if self._engine.member.time.is_member:
            return ""
        if (time_map := self._engine.member.time.time_map) is None or self._lost_ns is None:
            return f"relay {self.name} has not found a leader yet"
        return (
            f"relay {self.name} lost its leader {(now_ns - self._lost_ns) / 1e9:.0f} s ago and is in"
            f" holdover, accurate to {duration(time_map.uncertainty_at(now_ns))}"
        )
