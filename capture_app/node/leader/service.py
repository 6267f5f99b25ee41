"""Service of a leader for the streams that nodes and operators open."""

import asyncio
import contextlib
import time
from typing import Any

from msgspec.structs import replace

from capture_app.common.bounds import cut
from capture_app.common.camera_facts import PHONE
from capture_app.common.errors import (
    BadInputError,
    DiskError,
    IncompleteError,
    NetworkError,
    NotAvailableError,
    SimulshotError,
    TryAgainError,
    UnknownMachineError,
)
from capture_app.common.stagger import Stagger
from capture_app.common.tasks import end
from capture_app.common.timeouts import BUSY_TIMEOUT_S, DEPARTURE_TIMEOUT_S, UNDECIDED_S
from capture_app.net.channel import (
    MAX_PAYLOAD_BYTES,
    Channel,
    TooLargeMessageError,
    UnreadableMessageError,
)
from capture_app.net.udp import Pump
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.enrolment import Asked, Enrolment, is_node
from capture_app.node.leader.bursts import ActiveBursts
from capture_app.node.leader.camera_settings import CameraSettings
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.node.leader.memory_shares import MemoryShares
from capture_app.node.leader.snapshots import fitted_burst
from capture_app.node.leader.viewfinders import Viewfinders
from capture_app.node.leader.watchers import LeaderState, Watcher
from capture_app.protocol import messages, orders
from capture_app.protocol.permissions import check_allowed
from capture_app.protocol.status import NodeDetail
from capture_app.sync.rig.leader_engine import Leader
from capture_app.trust.identity import sign
from capture_app.trust.trust import Trust

WorkingOn = dict[tuple[int, int, str], BurstSession]
"""Session that a stream delivers images of, by the leader's run, the burst's number and the camera."""


STILL_SAVING_EVERY_S = 5.0
LOOKS = 50
"""Number of looks at a burst under way within BUSY_TIMEOUT_S."""


class ImageAnswers(asyncio.Queue[tuple[messages.ImageBatch, "asyncio.Future[str]"]]):
    """Answers to the images of one stream, in order, while further images arrive.

    Each is queued with the future of its checksum; its answer is that, or the future's error.
    """

    def __init__(self, channel: Channel[Any], trust: Trust) -> None:
        super().__init__()
        self._channel, self._trust = channel, trust
        self._sending = asyncio.create_task(self._send_all())

    async def send(
        self,
        message: Any,
        answer: messages.ImageAck | messages.ReportAck | messages.Refusal,
    ) -> None:
        """Send the answer to a node's message, signed where a relay passes it on."""
        if self._channel.who.via and isinstance(message, messages.CameraReport | messages.ImageBatch):
            answer = replace(
                answer,
                proof=sign(self._trust.identity, (message.camera, message.leader, message.burst), answer),
            )
        await self._channel.send(answer)

    async def close(self) -> None:
        """Stop answering; received images are saved all the same."""
        await end(self._sending)

    async def _send_all(self) -> None:
        while True:
            image, saving = await self.get()
            # The reader of a stream notices that it has broken off.
            with contextlib.suppress(NetworkError):
                while not (await asyncio.wait({saving}, timeout=STILL_SAVING_EVERY_S))[0]:
                    await self._channel.send(messages.ImageAck())
                if not saving.cancelled():
                    error = saving.exception()
                    refusal = messages.Refusal.of_error(error) if isinstance(error, SimulshotError) else None
                    await self.send(image, refusal or messages.ImageAck(sha256=saving.result()))
            self.task_done()


class LeaderService:
    """Handler of a leader's streams, many at a time."""

    def __init__(
        self,
        options: LeaderOptions,
        engine: Leader,
        pump: Pump,
        rig: LeaderState,
        bursts: ActiveBursts,
        local: LocalNodes | None,
        viewfinders: Viewfinders,
        enrolment: Enrolment,
    ) -> None:
        """`local` starts nodes on this machine; None if this leader runs none."""
        self.stop_requested = asyncio.Event()
        """Set when an operator orders this leader to end."""
        self._options, self._engine, self._pump = options, engine, pump
        self._rig, self._bursts, self._local, self._viewfinders = rig, bursts, local, viewfinders
        self._enrolment = enrolment
        self._settings = CameraSettings(options.sessions, viewfinders, options.log)
        self.roster_changed = asyncio.Event()
        """Set whenever a node has joined, was lost, or was removed."""
        self._memory = MemoryShares(2 * MAX_PAYLOAD_BYTES)
        self._speaking: dict[str, Channel[messages.ToLeader]] = {}
        """The one stream of each node that delivers images."""

    async def serve(self, channel: Channel[messages.ToLeader]) -> None:
        """Answer a stream until its peer closes it; errors of a request are sent as refusals, not raised."""
        working_on: WorkingOn = {}
        principal = ""
        answers = ImageAnswers(channel, self._options.trust)
        try:
            while (message := await self._receive(channel, principal)) is not None:
                try:
                    if isinstance(message, messages.ImageBatch):
                        answers.put_nowait((message, await self._take_images(channel, message, working_on)))
                        continue
                    check_allowed(channel.who, message)
                    self._check_speaker(channel, message, principal)
                    if isinstance(message, messages.NodeStream) and not message.shows:
                        principal = message.camera
                        if (earlier := self._speaking.get(principal, channel)) is not channel:
                            # Abandoned by the node, which may not occupy the port with many streams either.
                            earlier.abort()
                        self._speaking[principal] = channel
                    await answers.join()
                    if isinstance(message, messages.CameraReport):
                        await answers.send(
                            message, await self._take_report(message, channel.who.pin, working_on)
                        )
                    else:
                        await self._answer(channel, message)
                except (SimulshotError, OSError) as error:
                    is_answerable = isinstance(error, UnknownMachineError | TooLargeMessageError)
                    if isinstance(error, NetworkError) and not is_answerable:
                        raise
                    # Network errors are NetworkErrors, so this one is the disk's.
                    what = (
                        error
                        if isinstance(error, SimulshotError)
                        else DiskError(
                            f"the leader's disk failed: {error}",
                            hint="check it: capture-app doctor, on the leader's machine",
                        )
                    )
                    await answers.join()
                    await answers.send(message, messages.Refusal.of_error(what))
                if channel.who.is_unknown:
                    return  # it has its answer, and must not occupy the port
        finally:
            self._speaking = {
                name: speaker for name, speaker in self._speaking.items() if speaker is not channel
            }
            await answers.close()
            for (_, _, camera), session in working_on.items():
                session.stream_closed(camera, self._bursts.now_ns())

    async def _receive(self, channel: Channel[messages.ToLeader], principal: str) -> messages.ToLeader | None:
        """Return the next message; if it is unreadable, the bursts leave the camera out.

        Raises NetworkError, also for an unreadable message on a stream that is not a camera's.
        """
        while True:
            try:
                return await channel.receive_header()
            except UnreadableMessageError as error:
                if not principal:
                    raise
                text = f"{principal} sent an invalid message: {error.what}"
                self._options.log.say(text, camera=principal, level="warning")
                await self._bursts.give_up(principal, cut(f"it sent an invalid message: {error.what}"))
                await channel.send(messages.Refusal(what=text))

    def _check_speaker(
        self, channel: Channel[messages.ToLeader], message: messages.ToLeader, principal: str
    ) -> None:
        """Check that a camera's messages come from the node that joined by its name.

        Raises TryAgainError if that node is not joined, BadInputError if another node opened the stream.
        """
        match message:
            case messages.NodeStream():
                member = self._engine.roster.members.get(message.camera)
                if not is_node(channel.who, member, message.instance):
                    raise TryAgainError(f"no node has joined as {message.camera} by this stream's key")
                channel.is_known = True
            case messages.CameraReport() | messages.SpoolSpace():
                if message.camera != principal:
                    raise BadInputError(f"this stream may not send for camera {message.camera!r}")

    async def _take_images(
        self, channel: Channel[messages.ToLeader], batch: messages.ImageBatch, working_on: WorkingOn
    ) -> "asyncio.Future[str]":
        """Receive images that this stream has reported; permission was checked with the report."""
        if (session := working_on.get((batch.leader, batch.burst, batch.camera))) is None:
            raise BadInputError(f"this stream may not send for camera {batch.camera!r} in that burst")
        # It is in memory until it is written.
        await self._memory.take(channel.machine, batch.bytes)
        try:
            saving = await session.take(batch, channel.payload(), self._bursts.now_ns())
        finally:
            self._memory.give_back(channel.machine, batch.bytes)
        saving.add_done_callback(lambda _: self._bursts.report_progress(session))
        return saving

    async def _answer(self, channel: Channel[messages.ToLeader], message: messages.ToLeader) -> None:
        match message:
            case _ if isinstance(message, Asked):
                await self._enrolment.answer(channel, message)
            case messages.NodeStream(shows=False):
                await channel.send(messages.ReportAck())
            case messages.SpoolSpace():
                self._bursts.note_spool_space(message)
                await channel.send(messages.ReportAck())
            case messages.BurstRequest():
                async with contextlib.aclosing(self._bursts.take(message)) as progress:
                    async for status in progress:
                        await channel.send(messages.BurstAnswer(burst=fitted_burst(status)))
            case orders.WatchRequest():
                await Watcher(channel, self._rig, self._options.log, self._viewfinders).serve()
            case messages.NodeStream():
                giving = asyncio.create_task(self._settings.give(message.camera))
                try:
                    await self._viewfinders.serve(channel, message)
                finally:
                    giving.cancel()
            case _:
                await channel.send(await self._single_answer(message))

    async def _take_report(
        self, report: messages.CameraReport, pin: str, working_on: WorkingOn
    ) -> messages.ReportAck:
        session = await self._bursts.find_session(report, pin)
        if isinstance(session, messages.ReportAck):
            return session
        key = (report.leader, report.burst, report.camera)
        if (before := working_on.get(key)) is not session:
            session.stream_opened(report.camera)
            if before is not None:
                before.stream_closed(report.camera, self._bursts.now_ns())
            working_on[key] = session
        return await session.accept_report(report, self._bursts.now_ns(), wait_s=UNDECIDED_S)

    async def _single_answer(self, message: messages.ToLeader) -> messages.FromLeader:
        """Return the answer to a request that has one. Raises NetworkError for any other message."""
        match message:
            case messages.StatusRequest():
                await self._rig.look_at_disk()
                return messages.StatusAnswer(rig=self._rig.status(message.after))
            case orders.AskTime():
                return orders.TimeAnswer(leader_ns=self._bursts.now_ns(), unix_ns=time.time_ns())
            case orders.PlaceMark(mark=mark):
                return await self._bursts.place_mark(mark)
            case orders.SaveStamp():
                return await self._viewfinders.ask(message, orders.StampSaved)
            case orders.DetailRequest():
                return await self._viewfinders.ask(message, NodeDetail)
            case orders.ControlsRequest():
                return await self._settings.ask(message)
            case _ if isinstance(message, orders.Order):
                return await self.carry_out(message)
            case _:
                raise NetworkError(f"a {type(message).__name__} was not expected here")

    # Orders of operators other than bursts

    async def carry_out(self, order: orders.Order) -> orders.Done | orders.PhoneInvited:
        """Execute an order, and return when it is done. Raises the order's errors."""
        names: tuple[str, ...] = ()
        match order:
            case orders.AddCamera(spec=spec, name=name):
                names = (await self._nodes().add_camera(spec, name, self._taken()),)
            case orders.AddSimulated():
                names = await self._nodes().add_simulated(order, taken=self._taken())
            case orders.RemoveCamera(name=name):
                await self._remove(name)
            case orders.CancelBurst():
                await self._bursts.cancel(order.burst)
            case orders.EndBurst():
                await self._bursts.end(order.burst)
            case orders.StaggerCameras():
                await self._stagger(Stagger.parse(order.order) if order.order else None)
            case orders.InvitePhone():
                return await self._nodes().phones.invitation()
            case orders.StopRig():
                self._options.log.add("stopped by an operator")
                self.stop_requested.set()
        return orders.Done(names=names)

    async def _stagger(self, stagger: Stagger | None) -> None:
        """Change the planned order; a burst that has just been taken is awaited."""
        for _ in range(LOOKS):
            if not self._engine.orders.is_busy(now_ns := self._options.clock.now_ns()):
                self._engine.set_stagger(stagger, now_ns)
                self._pump.turn()
                return
            await asyncio.sleep(BUSY_TIMEOUT_S / LOOKS)
        raise IncompleteError("a burst is under way", hint="stagger the rig when it is over")

    def _nodes(self) -> LocalNodes:
        if self._local is None:
            raise NotAvailableError(
                "this leader runs no cameras", hint="run capture-app node on the camera's machine"
            )
        return self._local

    def _taken(self) -> list[str]:
        """Return the names in use: of present nodes, and of other machines' nodes, which may come back."""
        roster, trust = self._engine.roster, self._options.trust
        own_pin = "" if trust.is_open else trust.identity.pin
        others = (name for name, pin in roster.owners.items() if pin != own_pin)
        return [*filter(self._is_here, roster.members), *others]

    def _is_here(self, name: str) -> bool:
        member = self._engine.roster.members.get(name)
        return member is not None and not member.lost

    async def _remove(self, name: str) -> None:
        members = self._engine.roster.members
        is_local = self._local is not None and name in self._local.specs
        if is_local or (self._is_here(name) and members[name].camera.kind == PHONE):
            if self._local is not None and is_local:
                await self._local.remove(name)
            else:
                await self._viewfinders.put_off(name)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(DEPARTURE_TIMEOUT_S):
                    while self._is_here(name):
                        self.roster_changed.clear()
                        await self.roster_changed.wait()
            if name not in members:
                return
        if self._is_here(name):
            raise BadInputError(
                f"{self._engine.roster.title(name)} runs on {members[name].address[0]}, not as a process of"
                " the leader",
                hint="stop capture-app node there",
            )
        self._engine.forget(name)
        self._pump.turn()
