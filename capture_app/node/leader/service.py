"""What a leader does for the streams that nodes and operators open to it."""

import contextlib
from collections.abc import AsyncGenerator, Callable

from capture_app.errors import DiskFullError, NetworkError, SimulshotError, TryAgainError
from capture_app.net.channel import Channel
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.leader.active_bursts import ActiveBursts, CancelledBurstError
from capture_app.node.leader.orders import OperatorOrders
from capture_app.node.leader.viewfinders import Viewfinders
from capture_app.node.leader.watchers import Watchers
from capture_app.node.wire import messages, operating
from capture_app.node.wire.status import BurstStatus, RigStatus

WorkingOn = dict[tuple[int, int], tuple[BurstSession, str]]
"""By a leader's run and a burst's number, the session and the camera that a stream brings images of."""


class LeaderService:
    """Serves one stream after another, or many at a time, for one leader."""

    def __init__(
        self,
        bursts: ActiveBursts,
        get_status: Callable[[], RigStatus],
        take_burst: Callable[[messages.BurstRequest], AsyncGenerator[BurstStatus, None]],
        orders: OperatorOrders,
        viewfinders: Viewfinders,
        watchers: Watchers,
    ) -> None:
        """`take_burst` takes a burst and yields its progress."""
        self._bursts = bursts
        self._get_status = get_status
        self._take_burst = take_burst
        self._orders = orders
        self._viewfinders = viewfinders
        self._watchers = watchers

    async def serve(self, channel: Channel[messages.ToLeader]) -> None:
        """Answer a stream until its peer closes it; the user's mistakes are told, not raised."""
        working_on: WorkingOn = {}
        try:
            while (message := await channel.receive_header()) is not None:
                try:
                    await self._answer(channel, message, working_on)
                except NetworkError:
                    raise
                except SimulshotError as error:
                    retry = isinstance(error, DiskFullError | TryAgainError)
                    forget = isinstance(error, CancelledBurstError)
                    await channel.send(messages.Refusal.of_error(error, retry=retry, forget=forget))
        finally:
            for session, camera in working_on.values():
                session.stream_closed(camera, self._bursts.now_ns())

    async def _answer(
        self, channel: Channel[messages.ToLeader], message: messages.ToLeader, working_on: WorkingOn
    ) -> None:
        match message:
            case messages.StatusRequest():
                await channel.send(messages.StatusAnswer(rig=self._get_status()))
            case messages.BurstRequest():
                async with contextlib.aclosing(self._take_burst(message)) as progress:
                    async for status in progress:
                        await channel.send(messages.BurstAnswer(burst=status))
            case messages.CameraReport():
                session = await self._bursts.find_session(message)
                key, camera = (message.leader, message.burst), message.camera.name
                if key not in working_on or working_on[key][0] is not session:
                    session.stream_opened(camera)
                    if key in working_on:
                        working_on[key][0].stream_closed(camera, self._bursts.now_ns())
                    working_on[key] = session, camera
                receipts = await session.accept_report(message, self._bursts.now_ns())
                await channel.send(messages.ReportAck(receipts=receipts))
            case messages.SpoolSpace():
                self._bursts.note_spool_space(message)
                await channel.send(messages.ReportAck())
            case messages.ImageUpload():
                session = await self._bursts.find_session(message)
                sha256 = await session.receive_image(message, channel.payload(), self._bursts.now_ns())
                self._bursts.tell_progress(session)
                await channel.send(messages.ImageAck(sha256=sha256))
            case operating.WatchRequest():
                await self._watchers.serve(channel)
            case operating.ViewfinderOpened():
                await self._viewfinders.serve(channel, message)
            case operating.DetailRequest():
                detail = await self._viewfinders.detail(message.camera)
                await channel.send(operating.DetailAnswer(detail=detail))
            case (
                operating.AddCamera()
                | operating.AddSimulated()
                | operating.RemoveCamera()
                | operating.CancelBurst()
                | operating.StopRig()
            ):
                await channel.send(await self._orders.carry_out(message))
            case _:
                raise NetworkError(f"a {type(message).__name__} was not expected here")
