"""A leader and the gateway of its phones, in this process, on the loopback, over real TLS."""

import contextlib
import datetime
import socket
import time
from collections.abc import AsyncGenerator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from capture_app.common.node_state import NodeState
from capture_app.companions.phones.gateway import PhoneGateway
from capture_app.companions.phones.phone_camera import PhoneNodes
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol.messages import BurstRequest
from capture_app.session.reading.reader import Session
from capture_app.web.admission import Admission
from capture_app.web.certificate import own_certificate
from tests.cheap_rig import start_leader
from tests.unit.companions.phones.stand_in import StandInPhone
from tests.waiting import SLOW_PATIENCE_S, time_limit, until


@dataclass
class Place:
    """A leader and the gateway of its phones."""

    leader: LeaderNode
    admission: Admission
    base: str
    said: list[str]
    phones: list[StandInPhone] = field(default_factory=list)

    @property
    def url(self) -> str:
        return f"{self.base}#{self.admission.secret}"

    async def phone(self, **options: Any) -> StandInPhone:
        phone = StandInPhone(self.url, **options)
        await phone.open()
        self.phones.append(phone)
        return phone

    def state(self, name: str) -> NodeState | None:
        return next((node.state for node in self.leader.status().nodes if node.name == name), None)


@contextlib.asynccontextmanager
async def serving(
    folder: Path, size: tuple[int, int] = (320, 240), *, sound: bool = False
) -> AsyncGenerator[Place, None]:
    """A leader and a gateway on the loopback, until the block ends."""
    said: list[str] = []
    async with await start_leader(folder / "sessions") as leader:
        admission = Admission(time.monotonic)
        nodes = PhoneNodes((leader.own_address,), folder / "spool", said.append, sound=sound)
        gateway = PhoneGateway(admission, nodes.add, size, sound=sound)
        listening = socket.create_server(("127.0.0.1", 0))
        certificate = own_certificate(folder, (), datetime.datetime.now(datetime.UTC))
        place = Place(leader, admission, f"https://127.0.0.1:{listening.getsockname()[1]}/", said)
        try:
            async with gateway.serving(listening, certificate.server_context()):
                try:
                    yield place
                finally:
                    for phone in place.phones:
                        await phone.vanish()
        finally:
            await nodes.close()


async def ready(place: Place, *names: str) -> None:
    def all_are_ready() -> bool:
        return all(place.state(name) in (NodeState.READY, NodeState.DEGRADED) for name in names)

    await until(all_are_ready, seconds=SLOW_PATIENCE_S)


async def measured(place: Place, name: str) -> None:
    """Wait until a phone is in the rig, its clock known; a browser's fake camera may never be even."""
    known = (NodeState.ALIGNING, NodeState.READY, NodeState.DEGRADED)
    await until(lambda: place.state(name) in known, seconds=SLOW_PATIENCE_S)


async def burst(place: Place, frames: int, *, wait_ready_s: float = SLOW_PATIENCE_S) -> Session:
    """Take bursts until one is whole: on a starved machine frames come too late."""
    request = BurstRequest(frames=frames, wait_ready_s=wait_ready_s)
    async with time_limit(f"a whole burst of {frames} frames", SLOW_PATIENCE_S):
        while True:
            told = [status async for status in place.leader.bursts.take(request)]
            if told[-1].session and told[-1].received == told[-1].expected:
                return Session.open(Path(told[-1].session))
