"""Endpoint: what leaders, relays, standbys and cameras have in common, assembled and closed in one place.

Cameras and standbys follow leaders. Leaders have a port that others join; relays have both.
"""

from collections.abc import Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from socket import socket
from typing import Any, Self

from capture_app.common.address import DEFAULT_PORT, Address, own_machine_address, reachable_host
from capture_app.common.clock import HostClock, NodeClock
from capture_app.net.channel import Channel
from capture_app.net.discovery import Kind, announced
from capture_app.net.server import TransferServer
from capture_app.net.udp import Pump
from capture_app.node.enrolment import Enrolment
from capture_app.node.joining import Joining
from capture_app.protocol.log import Log
from capture_app.protocol.messages import ToLeader
from capture_app.sync.rig.failover import Failover, LeaderChoice
from capture_app.sync.rig.leader_engine import Leader
from capture_app.sync.tree.relay_engine import Relay
from capture_app.sync.tree.succession import Succession
from capture_app.trust.datagram_keys import LeaderKeys
from capture_app.trust.sealed_engines import SealedClient, SealedLeader, SealedRelay
from capture_app.trust.trust import Trust


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointOptions:
    """Options of every process of a rig."""

    clock: NodeClock = field(default_factory=HostClock)
    trust: Trust = field(default_factory=Trust.of_user)
    """This process's identity and the machines that it accepts and follows."""
    log: Log = field(default_factory=Log)
    """Receives the lines that a user may see."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PortOptions(EndpointOptions):
    """Options of a process that others join: a leader or a relay."""

    host: str = "0.0.0.0"  # noqa: S104 - cameras are other machines
    port: int = DEFAULT_PORT
    """Port for UDP and TCP; 0 for a free one."""


class Endpoint:
    """An engine on a UDP socket, with sealed datagrams unless the rig is open; it may `join` leaders."""

    def __init__(
        self,
        options: EndpointOptions,
        engine: Leader | Relay | Succession | Failover,
        sealed: SealedClient | SealedLeader,
        *handlers: Callable[[int], None],
    ) -> None:
        """`handlers` are called with the time, ns of this process's clock, when there may be new events."""
        self._clock, self._trust, self.log = options.clock, options.trust, options.log
        self._leave, self._handlers = engine.leave, handlers
        self.pump = Pump(engine if self._trust.is_open else sealed, self._clock, self._turned)

    def join(
        self,
        choice: LeaderChoice,
        keys: LeaderKeys,
        leaders: Sequence[Address] = (),
        **options: Any,
    ) -> Joining:
        """Join the leaders of a choice; the caller runs what is returned (`Joining.run`).

        `leaders` are their addresses as given, `options` are those of `Joining`.
        """
        joining = Joining(choice, keys, self.pump, self._trust, self.log, leaders, **options)
        self._handlers = (joining.look, *self._handlers)
        return joining

    async def stop(self) -> None:
        """Say goodbye to all peers, and close the socket."""
        self._handlers = ()
        self._leave()
        self.pump.turn()
        self.pump.close()

    def _turned(self) -> None:
        now_ns = self._clock.now_ns()
        for handle in self._handlers:
            handle(now_ns)


class PortEndpoint(Endpoint):
    """Endpoint with a port that others join, a leader's or a relay's."""

    def __init__(
        self,
        options: PortOptions,
        engine: Leader | Relay,
        sealed: SealedLeader,
        bound: tuple[socket, socket],
        drain: Callable[[int], None],
    ) -> None:
        """`bound` are the UDP and the listening TCP socket of the port, which `stop` closes."""
        self._kind: Kind = "relay" if isinstance(sealed, SealedRelay) else "leader"
        self.enrolment = Enrolment(options.trust, options.log, sealed)
        super().__init__(options, engine, sealed, self.enrolment.look, drain)
        self._host, self._bound = options.host, bound
        self.instance = (engine.leader if isinstance(engine, Relay) else engine).config.instance
        """Id of this run of the leader or relay, which distinguishes it from the next one."""
        family, port = bound[1].family, bound[1].getsockname()[1]
        self.address = Address(reachable_host(options.host, family), port)
        """Address for other machines."""
        self.own_address = own_machine_address(options.host, family, port)
        """Address for processes of this machine."""
        self._server: TransferServer[ToLeader] | None = None

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    async def start_serving(self, serve: Callable[[Channel[ToLeader]], Awaitable[None]]) -> None:
        """Pass each stream of the port to `serve`, and run the engine; what fails to start has stopped."""
        try:
            self._server = TransferServer(ToLeader, serve, trust=self._trust)
            await self._server.start(self._bound[1])
        except BaseException:
            await self.stop()
            raise
        self.pump.start(self._bound[0])

    def announced(
        self, *, name: str | None = None, among: Sequence[Address] = ()
    ) -> AbstractAsyncContextManager[None]:
        """Announce this process on the network while the block runs; `among` are all leaders of its rig."""
        where = self._host, self.address.port, self._kind
        return announced(*where, name=name, trust=self._trust, among=among, instance=self.instance)

    async def stop(self) -> None:
        """Say goodbye to all peers, and close the port."""
        await super().stop()
        if self._server is not None:
            await self._server.stop()
        for sock in self._bound:
            sock.close()
