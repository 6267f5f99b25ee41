"""What a leader does for the streams that nodes and the command line open to it."""

import contextlib
from collections.abc import AsyncGenerator
from typing import Protocol

from capture_app.errors import DiskFullError, NetworkError, SimulshotError, TryAgainError
from capture_app.net.multicast import BEACONS, BeaconSender
from capture_app.net.transfer import Channel
from capture_app.node.burst.bursts import BurstSession
from capture_app.node.wire.messages import (
    BurstAnswer,
    BurstRequest,
    CameraReport,
    ImageUpload,
    NodeSpace,
    Noted,
    Refusal,
    StatusAnswer,
    StatusRequest,
    Stored,
    ToLeader,
)
from capture_app.node.wire.status import BurstStatus, RigStatus
from capture_app.sync.rig.leader import Leader
from capture_app.sync.wire.beacon import Group
from capture_app.sync.wire.messages import NodeState


class Beacons:
    """Sends what an engine has for its group, if beacons are asked for."""

    def __init__(self, *, wanted: bool) -> None:
        self.group: Group | None = BEACONS if wanted else None
        self._sender: BeaconSender | None = None

    def send_due(self, engine: Leader, now_ns: int) -> None:
        """Send the beacon that is due, if any; `now_ns` is the engine's time."""
        beacon = engine.beacon_to_send()
        if beacon is None or self.group is None:
            return
        if self._sender is None:
            self._sender = BeaconSender(self.group)
        own = [view for view in engine.clients(now_ns) if view.via is None]
        self._sender.reach(view.address[0] for view in own if view.report.state is not NodeState.LOST)
        self._sender.send(beacon)

    def close(self) -> None:
        """Send no more. Calling it twice is harmless."""
        if self._sender is not None:
            self._sender.close()


class Rig(Protocol):
    """What the service needs of a leader."""

    def now_ns(self) -> int:
        """Return the rig's time in ns."""

    def status(self) -> RigStatus:
        """Return the rig at this moment."""

    def take_burst(self, request: BurstRequest) -> AsyncGenerator[BurstStatus, None]:
        """Take a burst and yield its progress."""

    async def session_of(self, message: CameraReport | ImageUpload) -> BurstSession:
        """Return the burst of an upload."""

    def space_told(self, space: NodeSpace) -> None:
        """Note how much room a node has."""

    def image_stored(self, session: BurstSession) -> None:
        """Tell how far a burst is."""


class Service:
    """Serves one stream after another, or many at a time, for one leader."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig

    async def serve(self, channel: Channel[ToLeader]) -> None:
        """Answer a stream until its peer closes it; the user's mistakes are told, not raised."""
        working_on: dict[tuple[int, int], tuple[BurstSession, str]] = {}
        try:
            while (message := await channel.receive_head()) is not None:
                try:
                    await self._answer(channel, message, working_on)
                except NetworkError:
                    raise
                except SimulshotError as error:
                    await channel.send(
                        Refusal(
                            what=error.what,
                            hint=error.hint,
                            error=type(error).__name__,
                            retry=isinstance(error, DiskFullError | TryAgainError),
                        )
                    )
        finally:
            for session, camera in working_on.values():
                session.stream_closed(camera, self._rig.now_ns())

    async def _answer(
        self,
        channel: Channel[ToLeader],
        message: ToLeader,
        working_on: dict[tuple[int, int], tuple[BurstSession, str]],
    ) -> None:
        match message:
            case StatusRequest():
                await channel.send(StatusAnswer(rig=self._rig.status()))
            case BurstRequest():
                async with contextlib.aclosing(self._rig.take_burst(message)) as progress:
                    async for status in progress:
                        await channel.send(BurstAnswer(burst=status))
            case CameraReport():
                session = await self._rig.session_of(message)
                key, camera = (message.leader, message.burst), message.camera.name
                if key not in working_on or working_on[key][0] is not session:
                    session.stream_opened(camera)
                    if key in working_on:
                        working_on[key][0].stream_closed(camera, self._rig.now_ns())
                    working_on[key] = session, camera
                held = await session.take_report(message, self._rig.now_ns())
                await channel.send(Noted(held=held))
            case NodeSpace():
                self._rig.space_told(message)
                await channel.send(Noted())
            case ImageUpload():
                session = await self._rig.session_of(message)
                sha256 = await session.take_image(message, channel.payload(), self._rig.now_ns())
                self._rig.image_stored(session)
                await channel.send(Stored(sha256=sha256))
