"""A network in memory: datagrams and streams between machines, late, lost, doubled, cut."""

import asyncio
import contextlib
import contextvars
import errno
import os
import random
import socket
import struct
from asyncio import sslproto
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

from capture_app.node import joining
from capture_app.protocol.pairing_messages import FoundLeader
from tests.virtual.world import WALL_NS, KilledError, Process, process

if TYPE_CHECKING:
    from tests.virtual.world import World

WINDOW_BYTES = 1 << 17
"""What a receiver's kernel takes in that its process has not read yet."""
MAX_QUEUE = 2000
RETRANSMIT_NS = 200_000_000
_TIMESPEC = struct.Struct("@ll")
_SO_TIMESTAMPNS = 35


@dataclass
class Link:
    """One direction between two machines."""

    rng: random.Random
    base_ns: int = 300_000
    jitter_ns: int = 500_000
    """Mean of the exponential part of the delay."""
    loss: float = 0.0
    double: float = 0.0
    bytes_per_s: float = 20e6
    is_cut: bool = False
    held: list[Callable[[], None]] = field(default_factory=list)
    """Stream chunks that wait until the link is whole again."""
    sent: int = 0
    sleeps_ns: Callable[[], int] = lambda: 0
    """Time until a receiver that saves power listens again."""

    def delay_ns(self) -> int:
        """Draw one delay."""
        return self.base_ns + round(self.rng.expovariate(1.0) * self.jitter_ns) + self.sleeps_ns()


class VirtualSocket:
    """A UDP socket, or a listening one, of the process that made it."""

    def __init__(self, network: "Network", owner: Process, kind: int) -> None:
        self._network, self.owner, self.kind = network, owner, kind
        self.family, self.type, self.proto = socket.AF_INET, kind, 0
        self.address: tuple[str, int] | None = None
        self.queue: deque[tuple[bytes, tuple[str, int], int]] = deque()
        self.number = network.new_number()
        self.reader: asyncio.Handle | None = None
        self.is_open = True
        self.peer: tuple[str, int] = ("", 0)
        network._sockets[self.number] = self
        owner.on_death.append(self.close)

    def fileno(self) -> int:
        return self.number

    def setblocking(self, *_: Any) -> None: ...
    def setsockopt(self, *_: Any) -> None: ...
    def listen(self, *_: Any) -> None: ...

    def bind(self, where: tuple[str, int]) -> None:
        self.address = self._network.bind(self, where)

    def connect(self, peer: tuple[str, int]) -> None:
        self.peer = (peer[0], peer[1])
        self._bound()

    def getsockname(self) -> tuple[str, int]:
        return self._bound()

    def _bound(self) -> tuple[str, int]:
        if self.address is None:
            self.bind(("0.0.0.0", 0))
        assert self.address is not None
        return self.address

    def sendto(self, data: bytes, address: tuple[str, int]) -> int:
        if not self.owner.is_alive:
            raise KilledError
        self._network.send_datagram(self, bytes(data), (address[0], address[1]))
        return len(data)

    def recvmsg(self, *_: Any) -> tuple[bytes, list[Any], int, tuple[str, int]]:
        if not self.queue:
            raise BlockingIOError
        data, sender, at_ns = self.queue.popleft()
        stamp = _TIMESPEC.pack(*divmod(WALL_NS + at_ns, 1_000_000_000))
        return data, [(socket.SOL_SOCKET, _SO_TIMESTAMPNS, stamp)], 0, sender

    def recvfrom(self, *_: Any) -> tuple[bytes, tuple[str, int]]:
        message = self.recvmsg()
        return message[0], message[3]

    def close(self) -> None:
        if self.is_open:
            self.is_open = False
            self._network.release(self)

    def __enter__(self) -> "VirtualSocket":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class MemoryTransport(asyncio.Transport):
    """One end of a stream."""

    _start_tls_compatible = True

    def __init__(self, network: "Network", owner: Process, where: tuple[str, int], context: Any) -> None:
        super().__init__()
        self.network, self.owner, self.where, self._context = network, owner, where, context
        self.peer: MemoryTransport
        self._protocol: Any = None
        self._is_closing = self._is_lost = self._is_paused = self._write_paused = False
        self._is_reading = True
        self._unread: deque[bytes | None] = deque()
        self._unacked = 0
        self._arrives_ns = 0
        self._low, self._high = 1 << 14, 1 << 16
        owner.on_death.append(self.die)

    # What asyncio asks of a transport

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        if name == "peername":
            return self.peer.where
        if name == "sockname":
            return self.where
        if name == "socket":
            return _NoSocket()
        return default

    def set_protocol(self, protocol: Any) -> None:
        self._protocol = protocol

    def get_protocol(self) -> Any:
        return self._protocol

    def is_closing(self) -> bool:
        return self._is_closing

    def is_reading(self) -> bool:
        return self._is_reading and not self._is_closing

    def pause_reading(self) -> None:
        self._is_reading = False

    def resume_reading(self) -> None:
        self._is_reading = True
        self.soon(self._read)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        if high is None:
            high = (1 << 16) if low is None else 4 * low
        self._low, self._high = high // 4 if low is None else low, high

    def get_write_buffer_limits(self) -> tuple[int, int]:
        return self._low, self._high

    def get_write_buffer_size(self) -> int:
        return max(0, self._unacked - WINDOW_BYTES)

    def can_write_eof(self) -> bool:
        return False

    def write_eof(self) -> None:
        raise NotImplementedError("no product's stream is closed in one direction only")

    def write(self, data: Any) -> None:
        if not self.owner.is_alive:
            raise KilledError
        if self._is_closing or not data:
            return
        data = bytes(data)
        self._unacked += len(data)
        self._transmit(data)
        if self.get_write_buffer_size() > self._high and not self._write_paused:
            self._write_paused = True
            self._protocol.pause_writing()

    def writelines(self, of: Any) -> None:
        self.write(b"".join(of))

    def close(self) -> None:
        if not self._is_closing:
            self._is_closing = True
            self._transmit(None)
            self.soon(self._lose, None)

    def abort(self) -> None:
        self._force_close(None)

    def _force_close(self, error: Exception | None) -> None:
        """Reset the stream: TLS calls this where it fails, and from Python 3.13 on to abort."""
        if not self._is_lost:
            self._is_closing = True
            self._transmit_reset()
            self.soon(self._lose, error)

    # The network's side

    def soon(self, call: Callable[..., None], *arguments: Any) -> None:
        self.network.world.loop.call_soon(call, *arguments, context=self._context)

    def made(self, protocol: Any) -> None:
        """Give the end its protocol, in its own process."""
        self._protocol = protocol
        protocol.connection_made(self)

    def _lose(self, error: Exception | None) -> None:
        if not self._is_lost:
            self._is_lost = self._is_closing = True
            if self._protocol is not None:
                self._protocol.connection_lost(error)

    def _transmit(self, chunk: bytes | None) -> None:
        link = self.network.link(self.owner.machine, self.peer.owner.machine)

        def go() -> None:
            world = self.network.world
            late_ns = link.delay_ns() + round((0 if chunk is None else len(chunk)) / link.bytes_per_s * 1e9)
            while link.rng.random() < link.loss:
                late_ns += RETRANSMIT_NS
            self._arrives_ns = max(self._arrives_ns + 1, world.now_ns + late_ns)
            world.at(self._arrives_ns, arrive)

        def arrive() -> None:
            if link.is_cut:
                link.held.append(go)
            elif self.peer._is_lost or not self.peer.owner.is_alive:
                # There is nobody at that port any more: its machine says so, where it is on.
                if self.network.is_on(self.peer.owner.machine):
                    self.soon(self._lose, ConnectionResetError(errno.ECONNRESET, "Connection reset by peer"))
            else:
                self.peer._unread.append(chunk)
                self.peer.soon(self.peer._read)

        (link.held.append if link.is_cut else lambda work: work())(go)

    def _transmit_reset(self) -> None:
        link = self.network.link(self.owner.machine, self.peer.owner.machine)
        if not link.is_cut and self.network.is_on(self.owner.machine):
            peer, error = self.peer, ConnectionResetError(errno.ECONNRESET, "Connection reset by peer")
            world = self.network.world
            self._arrives_ns = max(self._arrives_ns + 1, world.now_ns + link.delay_ns())
            world.at(self._arrives_ns, lambda: peer.soon(peer._lose, error))

    def _read(self) -> None:
        while self._unread and self._is_reading and not self._is_lost:
            chunk = self._unread.popleft()
            if chunk is None:
                if not self._protocol.eof_received():
                    self.close()
                return
            if isinstance(self._protocol, asyncio.BufferedProtocol):
                _feed(self._protocol, chunk)
            else:
                self._protocol.data_received(chunk)
            self.peer._acknowledge(len(chunk))

    def _acknowledge(self, size: int) -> None:
        self._unacked -= size
        if self._write_paused and self.get_write_buffer_size() <= self._low:
            self._write_paused = False
            self.soon(self._resume)

    def _resume(self) -> None:
        if not self._is_lost:
            self._protocol.resume_writing()

    def die(self) -> None:
        """Vanish with the process: its kernel resets the stream, if the machine is still on."""
        if not self._is_lost:
            self._is_lost = self._is_closing = True
            self._transmit_reset()


def _feed(protocol: Any, data: bytes) -> None:
    while data:
        buffer = protocol.get_buffer(len(data))
        size = min(len(buffer), len(data))
        buffer[:size] = data[:size]
        protocol.buffer_updated(size)
        data = data[size:]


class _NoSocket:
    def setsockopt(self, *_: Any) -> None: ...


class MemoryServer:
    """What `asyncio.start_server` returns."""

    def __init__(self, network: "Network", listening: VirtualSocket) -> None:
        self._network, self._listening = network, listening

    def close(self) -> None:
        self._listening.close()

    async def wait_closed(self) -> None: ...

    def is_serving(self) -> bool:
        return self._listening.is_open


class VirtualBrowser:
    """Listener for the announcements in a virtual network."""

    def __init__(self, network: "Network") -> None:
        self._network, self._machine = network, getattr(process.get(), "machine", "")

    async def __aenter__(self) -> "VirtualBrowser":
        return self

    async def __aexit__(self, *_: object) -> None: ...

    async def refresh(self) -> None:
        """Listen; it always does."""

    @property
    def found(self) -> tuple[FoundLeader, ...]:
        """The leaders whose announcements reach this machine."""
        announced = self._network.announced()
        return tuple(
            of for name, of in announced.items() if not self._network.link(name, self._machine).is_cut
        )


class Network:
    """All machines' addresses, sockets and links."""

    def __init__(self, world: "World") -> None:
        self.world = world
        self._hosts: dict[str, str] = {}
        self._links: dict[tuple[str, str], Link] = {}
        self._bound: dict[tuple[int, str, int], VirtualSocket] = {}
        self._servers: dict[tuple[str, int], tuple[Callable[[], Any], VirtualSocket, Any]] = {}
        self._sockets: dict[int, VirtualSocket] = {}
        self._number = 1 << 20
        self._ports: dict[str, int] = {}
        self._off: set[str] = set()
        self.shape: Callable[[str, str, Link], None] = lambda _, __, ___: None
        """Gives a new link its delays."""
        self.announced: Callable[[], dict[str, FoundLeader]] = dict
        """Returns the leaders that are announced, by machine."""

    def new_number(self) -> int:
        """Return the next file number."""
        self._number += 1
        return self._number

    def host(self, machine: str) -> str:
        """Return a machine's address."""
        return self._hosts.setdefault(machine, f"10.0.0.{len(self._hosts) + 1}")

    def machine_at(self, host: str) -> None:
        """Let there be a machine whose name is its address."""
        self._hosts[host] = host

    def _machine(self, host: str) -> str | None:
        return next((name for name, of in self._hosts.items() if of == host), None)

    def link(self, source: str, target: str) -> Link:
        """Return one direction between two machines."""
        if (found := self._links.get((source, target))) is None:
            found = Link(self.world.chance("link", source, target))
            if source == target:
                found.base_ns, found.jitter_ns = 20_000, 10_000
            else:
                self.shape(source, target, found)
            self._links[source, target] = found
        return found

    def counts(self) -> dict[str, int]:
        """Return the number of datagrams that were sent over each link."""
        return {f"{source} to {target}": link.sent for (source, target), link in self._links.items()}

    def links_of(self, machine: str) -> list[Link]:
        """Return all links from and to a machine."""
        others = [name for name in self._hosts if name != machine]
        return [link for name in others for link in (self.link(machine, name), self.link(name, machine))]

    def cut(self, machine: str, *, is_cut: bool) -> None:
        """Cut a machine off from all others, or connect it again."""
        for link in self.links_of(machine):
            link.is_cut = is_cut
            if not is_cut:
                held, link.held = link.held, []
                for go in held:
                    go()

    def switch(self, machine: str, *, on: bool) -> None:
        """Note that a machine has lost its power, or has it again."""
        (self._off.discard if on else self._off.add)(machine)

    def is_on(self, machine: str) -> bool:
        """Return whether a machine has power."""
        return machine not in self._off

    def drop(self, one: Process) -> None:
        """Close all that a killed process had open."""
        for close in one.on_death:
            close()
        one.on_death.clear()

    # Sockets

    def bind(self, of: VirtualSocket, where: tuple[str, int]) -> tuple[str, int]:
        """Give a socket its port."""
        host, port = self.host(of.owner.machine), where[1]
        if not port:
            port = self._ports[host] = self._ports.get(host, 40000) + 1
        if (of.kind, host, port) in self._bound:
            raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE))
        self._bound[of.kind, host, port] = of
        return host, port

    def release(self, of: VirtualSocket) -> None:
        """Free a closed socket's port."""
        self._sockets.pop(of.number, None)
        if of.address is not None:
            self._bound.pop((of.kind, *of.address), None)
            if self._servers.get(of.address, (None, None))[1] is of:
                del self._servers[of.address]

    def watch(self, number: Any, reader: asyncio.Handle) -> None:
        """Call a reader whenever a socket has datagrams."""
        of = self._socket(number)
        of._bound()
        of.reader = reader
        if of.queue:
            self._wake(of)

    def unwatch(self, number: Any) -> bool:
        """Stop calling a socket's reader."""
        of = self._sockets.get(number if isinstance(number, int) else number.fileno())
        had = of is not None and of.reader is not None
        if of is not None:
            of.reader = None
        return had

    def _socket(self, number: Any) -> VirtualSocket:
        return self._sockets[number if isinstance(number, int) else number.fileno()]

    def send_datagram(self, of: VirtualSocket, data: bytes, to: tuple[str, int]) -> None:
        """Send a datagram on its way."""
        sender = of.getsockname()
        target = self._machine(to[0])
        if target is None:
            return
        link = self.link(of.owner.machine, target)
        link.sent += 1
        lost = link.rng.random() < link.loss
        if lost or link.is_cut:
            return
        for _ in range(2 if link.rng.random() < link.double else 1):
            self.world.at(self.world.now_ns + link.delay_ns(), lambda: self._deliver(link, data, sender, to))

    def _deliver(self, link: Link, data: bytes, sender: tuple[str, int], to: tuple[str, int]) -> None:
        of = self._bound.get((socket.SOCK_DGRAM, *to))
        if of is not None and not link.is_cut and len(of.queue) < MAX_QUEUE:
            of.queue.append((data, sender, self.world.now_ns))
            self._wake(of)

    def _wake(self, of: VirtualSocket) -> None:
        if of.reader is not None:
            self.world.loop.call_soon(self._readable, of, context=cast(Any, of.reader)._context)

    def _readable(self, of: VirtualSocket) -> None:
        if of.reader is not None and of.queue:
            reader = cast(Any, of.reader)
            reader._callback(*reader._args)
            if of.queue:
                self._wake(of)

    # Streams

    def serve(self, factory: Callable[[], Any], listening: Any) -> MemoryServer:
        """Accept streams on a listening socket."""
        self._servers[listening.getsockname()] = (factory, listening, contextvars.copy_context())
        return MemoryServer(self, listening)

    async def connect(self, factory: Callable[[], Any], host: str, port: int, ssl: Any) -> Any:
        """Open a stream and return transport and protocol, as `loop.create_connection`."""
        owner, loop = process.get(), self.world.loop
        assert owner is not None, "only processes have a network"
        target = self._machine(host)
        out = None if target is None else self.link(owner.machine, target)
        if out is None:
            raise OSError(errno.EHOSTUNREACH, "No route to host")
        round_trip_ns = out.delay_ns() + out.delay_ns()
        while out.rng.random() < out.loss:
            round_trip_ns += 1_000_000_000
        await asyncio.sleep(round_trip_ns / 1e9)
        while out.is_cut or not self.is_on(str(target)):  # noqa: ASYNC110 - as TCP, which asks again
            await asyncio.sleep(1.0)
        if (found := self._servers.get((host, port))) is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused")
        server_factory, listening, context = found
        own_port = self._ports[self.host(owner.machine)] = (
            self._ports.get(self.host(owner.machine), 40000) + 1
        )
        near = MemoryTransport(self, owner, (self.host(owner.machine), own_port), contextvars.copy_context())
        far = MemoryTransport(self, listening.owner, (host, port), context)
        near.peer, far.peer = far, near
        far.soon(lambda: far.made(server_factory()))
        protocol = factory()
        if ssl is None:
            near.made(protocol)
            return near, protocol
        waiter = loop.create_future()
        over = sslproto.SSLProtocol(loop, protocol, ssl, waiter, server_side=False, server_hostname=host)
        near.made(over)
        try:
            await waiter
        except BaseException:
            near.abort()
            raise
        return over._app_transport, protocol

    def getaddrinfo(self, host: Any, port: Any, type: int = socket.SOCK_DGRAM, **_: Any) -> Any:
        """Return a numeric address as it is."""
        return [(socket.AF_INET, type, 0, "", (str(host or "0.0.0.0"), int(port)))]

    @contextlib.contextmanager
    def entered(self, replaced: Callable[..., None]) -> Iterator[None]:
        """Give processes virtual sockets within the block."""
        network, real = self, socket.socket

        class Socket(real):  # type: ignore[misc, valid-type]
            def __new__(cls, family: Any = -1, kind: Any = -1, *rest: Any, **options: Any) -> Any:
                if (owner := process.get()) is None:
                    return super().__new__(cls, family, kind, *rest, **options)
                return VirtualSocket(network, owner, int(kind))

        real_info = socket.getaddrinfo

        def info(host: Any, port: Any, *rest: Any, **options: Any) -> Any:
            if process.get() is None:
                return real_info(host, port, *rest, **options)
            kind = options.get("type", socket.SOCK_STREAM)
            return self.getaddrinfo(host, port, type=kind)

        replaced(socket, socket=Socket, getaddrinfo=info)
        replaced(joining, LeaderBrowser=lambda: VirtualBrowser(self))
        yield
