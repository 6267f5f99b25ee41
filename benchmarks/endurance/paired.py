"""Malicious paired camera against a running rig: it claims names, streams, images and bursts of others."""

import asyncio
import socket
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from benchmarks.endurance.hostile_messages import FACTS, RECORD
from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, SimulshotError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import Channel, connect
from capture_app.net.udp import client_socket
from capture_app.protocol import messages as wire
from capture_app.protocol.status import Preview
from capture_app.rig.rig_link import ask_status
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.datagrams import Hello, TimeRequest, Welcome
from capture_app.trust.datagram_keys import LeaderKeys
from capture_app.trust.trust import Trust

OTHERS = ("cam1", "cam2")
SLOW_NS = 1_000_000_000
STREAMS, PREVIEW_BYTES = 300, 30 << 20
LOOK_EVERY_S = 0.25


@dataclass(slots=True)
class PairedThief:
    """Attempts of the malicious machine, what was granted, and how an operator fared meanwhile."""

    leader: Address
    trust: Trust
    names: int = 0
    welcomes: int = 0
    streams: int = 0
    thefts: int = 0
    """Other machines' names under which it was accepted, or messages of theirs that were not refused."""
    tried: int = 0
    answers_s: list[float] = field(default_factory=list)
    """Response time of each status request of an operator."""
    unanswered: int = 0
    """Number of status requests that were refused or not answered."""
    most_nodes: int = 0

    async def attack(self, names: int, burst: tuple[int, int]) -> None:
        """Make all attempts once; `burst` is another machine's, by the leader's instance and its number."""
        held: list[Channel[Any]] = []
        with client_socket(socket.AF_INET) as sock:
            for number in range(names):
                slow = replace(FACTS, period_ns=SLOW_NS) if number % 2 else FACTS
                self.names += 1
                self.welcomes += await self._hello(sock, f"made-up-{number}", number + 1, slow)
            for name in OTHERS * 5:
                self.tried += 1
                self.thefts += await self._hello(sock, name, 5_000 + self.tried, FACTS)
            for run in (1, 5_001):
                for name in OTHERS:
                    await self._bring(name, run, burst)
            for number in range(STREAMS):
                with suppress(SimulshotError):
                    held.append(await self._show(f"made-up-{number % 8}", number % 8 + 1, number < 8))
                    self.streams += 1
        for channel in held:
            channel.abort()

    async def look(self) -> None:
        """Request the status as an operator does, repeatedly, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            began_s = loop.time()
            try:
                status = await ask_status(self.leader)
                self.most_nodes = max(self.most_nodes, len(status.nodes))
                self.answers_s.append(loop.time() - began_s)
            except SimulshotError:
                self.unanswered += 1
            await asyncio.sleep(LOOK_EVERY_S)

    async def _hello(self, sock: socket.socket, name: str, run: int, facts: Any) -> bool:
        """Request to join under a name, with a key for it; return whether that was granted."""
        loop, keys = asyncio.get_running_loop(), LeaderKeys()
        with suppress(SimulshotError, TimeoutError, ValueError):
            async with await connect(self.leader, wire.FromLeader, trust=self.trust) as channel:
                await channel.send(wire.KeyRequest(name=name, instance=run))
                answer = await channel.receive_header()
            if not isinstance(answer, wire.KeyAnswer):
                return False
            keys.hold(self.leader, answer.grant)
            data = keys.seal(encode(Hello(name, run, facts)), self.leader)
            await loop.sock_sendto(sock, data or b"", tuple(self.leader))
            async with asyncio.timeout(0.2):
                said = decode(keys.open(await loop.sock_recv(sock, 2048), self.leader))
            if isinstance(said, Welcome):
                data = keys.seal(encode(TimeRequest(said.client, 0, 0)), self.leader)
                await loop.sock_sendto(sock, data or b"", tuple(self.leader))
                return True
        return False

    async def _bring(self, name: str, run: int, burst: tuple[int, int]) -> None:
        """Pose as another machine's camera: its stream, its report of a burst, its disk."""
        record = replace(RECORD, name=name)
        report = wire.CameraReport(
            leader=burst[0], burst=burst[1], plan=CameraPlan(camera=record, reported=True, instants=(0, 1))
        )
        room = wire.SpoolSpace(camera=name, free_bytes=0, spool="/")
        with suppress(NetworkError):
            async with await connect(self.leader, wire.FromLeader, trust=self.trust) as channel:
                for message in (wire.NodeStream(camera=name, instance=run), report, room):
                    self.tried += 1
                    await channel.send(message)
                    said = await channel.receive_header()
                    self.thefts += said is not None and not isinstance(said, wire.Refusal)

    async def _show(self, name: str, run: int, with_picture: bool) -> Channel[Any]:
        """Open a viewfinder of its own, and send an image that was not requested."""
        channel = await connect(self.leader, wire.FromLeader, trust=self.trust)
        await channel.send(wire.NodeStream(camera=name, instance=run, shows=True))
        if with_picture:
            frame = Preview(camera=name, leader_ns=0, width=1, height=1)
            await channel.send(frame, bytes(PREVIEW_BYTES))
        return channel


def paired_machine(folder: Path) -> Trust:
    """Return another machine, known as a camera to the rig of this process's user."""
    machine, home = Trust(folder), Trust.of_user()
    own, other = machine.identity, home.identity
    machine.known.add(other.pin, Role.LEADER, name="leader", certificate=other.certificate)
    home.known.add(own.pin, Role.CAMERA, name="thief", certificate=own.certificate)
    return machine
