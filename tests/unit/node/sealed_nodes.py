"""Nodes without a camera that join a leader with sealed datagrams, over real UDP and TLS."""

import asyncio
import contextlib
import secrets
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from random import Random

from capture_app.common.address import Address
from capture_app.common.camera_facts import CameraFacts
from capture_app.common.clock import HostClock
from capture_app.common.pairing_codes import Role
from capture_app.net.udp import Pump, SinglePeerEngine, client_socket
from capture_app.node.joining import Joining
from capture_app.protocol.log import Log
from capture_app.sync.rig.failover import LeaderChoice
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.sync_engine import Engine
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.wire.datagrams import CLOCK
from capture_app.trust.sealed_engines import SealedClient
from capture_app.trust.trust import Trust


class SealedNode:
    """A running node."""

    def __init__(self, name: str, instance: int, camera: CameraFacts) -> None:
        self.name, self.instance = name, instance
        self.time = TimeClient(name, instance, Timekeeper(1), camera)
        self.sealed: SealedClient


@asynccontextmanager
async def sealed_node(
    leader: Address,
    trust: Trust,
    name: str = "cam",
    instance: int | None = None,
    standbys: tuple[Address, ...] = (),
    camera: CameraFacts = CLOCK,
) -> AsyncIterator[SealedNode]:
    """A node of a machine that goes by `trust`, until the block ends."""
    node = SealedNode(name, secrets.randbits(62) if instance is None else instance, camera)
    engine: Engine = SinglePeerEngine(node.time, leader)
    choice = LeaderChoice((leader,), node.time)
    if standbys:
        engine = choice = TreeMember(name, node.instance, (leader, *standbys), Random(1))
        node.time = choice.time
    node.sealed = SealedClient(engine)
    clock = HostClock()
    pump = Pump(node.sealed, clock, lambda: joining.look(clock.now_ns()))
    joining = Joining(choice, node.sealed.leader_keys, pump, trust, Log())
    asking = asyncio.create_task(joining.run())
    pump.start(client_socket(socket.AF_INET))
    try:
        yield node
    finally:
        pump.close()
        asking.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asking


def introduced(folder: Path, leader: Trust, name: str, role: Role = Role.CAMERA) -> Trust:
    """The trust of another machine, which the leader's and it know."""
    machine = Trust(folder / name)
    one, other = machine.identity, leader.identity
    machine.known.add(other.pin, Role.LEADER, name="leader", certificate=other.certificate)
    leader.known.add(one.pin, role, name=name, certificate=one.certificate)
    return machine


@contextmanager
def hostile_socket() -> Iterator[socket.socket]:
    """A socket from which anything may come."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.setblocking(False)
        yield sock
