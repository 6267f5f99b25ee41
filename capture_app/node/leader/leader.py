"""The leader of a rig: the engine on a socket, the images' server, and the sessions it saves."""

import asyncio
import contextlib
import random
import secrets
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Coroutine, Sequence
from pathlib import Path
from typing import Any, Self

from capture_app.clock import HostClock, NodeClock
from capture_app.errors import IncompleteError, SimulshotError
from capture_app.net.address import DEFAULT_PORT, Address, reachable_host
from capture_app.net.transfer import TransferServer, bind
from capture_app.net.udp import Pump
from capture_app.node.burst.bursts import BurstSession
from capture_app.node.burst.resume import RETURN_NS, Revival
from capture_app.node.leader.readiness import create_numbered, not_ready
from capture_app.node.leader.service import Beacons, Service
from capture_app.node.leader.snapshots import node_statuses
from capture_app.node.leader.space import check_room, expected_image_bytes
from capture_app.node.leader.wording import News
from capture_app.node.wire.messages import BurstRequest, CameraReport, ImageUpload, NodeSpace, ToLeader
from capture_app.node.wire.status import BurstStatus, RigStatus
from capture_app.session.writing.store import SessionWriter
from capture_app.sync.rig.events import BurstRefused
from capture_app.sync.rig.frame_picks import Burst
from capture_app.sync.rig.leader import ClientView, Leader, LeaderConfig
from capture_app.sync.wire.messages import NodeState

SNAPSHOT_EVERY_S = 0.25
HOUSEKEEPING_EVERY_S = 0.25
MAX_OPEN_BURSTS = 16


class LeaderNode:
    """A running leader; `async with LeaderNode(...)` binds its port and serves until the block ends."""

    def __init__(
        self,
        *,
        sessions: Path,
        host: str = "0.0.0.0",  # noqa: S104 - cameras are other machines
        port: int = DEFAULT_PORT,
        period_ns: int | None = None,
        align_row: float | None = None,
        max_delay_ns: int = 0,
        reference_broadcast: bool = False,
        clock: NodeClock | None = None,
        on_news: Callable[[News], None] | None = None,
        revive: Sequence[Path] | None = None,
        return_ns: int = RETURN_NS,
    ) -> None:
        """`revive` are the interrupted sessions to finish, else all; nodes have `return_ns` to come back.

        `period_ns`, `align_row` and `max_delay_ns` are the engine's, see `LeaderConfig`. With
        `reference_broadcast` nodes that hear the same multicast packets agree with each other.
        """
        self.sessions = sessions
        self.address = Address(host, port)
        self._host = host
        self._port = port
        self._period_ns, self._align_row, self._max_delay_ns = period_ns, align_row, max_delay_ns
        self._beacons = Beacons(wanted=reference_broadcast)
        self._clock: NodeClock = clock or HostClock()
        self._on_news = on_news or (lambda _: None)
        self._bursts: dict[int, BurstSession] = {}
        self._last_burst: BurstSession | None = None
        self._last_number = 0
        self._saved: list[str] = []
        self._revive = revive
        self._return_ns = return_ns
        self._image_bytes: dict[str, int] = {}
        self._spools: dict[str, NodeSpace] = {}
        self.revival = Revival(sessions, self._revived)
        """The sessions of earlier runs that are being finished."""
        self._tasks: set[asyncio.Task[None]] = set()
        self._engine: Leader
        self._pump: Pump
        self._server: TransferServer[ToLeader]
        self._instance = 0

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    async def start(self) -> None:
        """Bind and serve. Raises NetworkError where the port is in use or the host is not this machine's."""
        datagrams, listening = bind(self._host, self._port)
        port = listening.getsockname()[1]
        self.address = Address(reachable_host(self._host, listening.family), port)
        self._instance = secrets.randbits(32)
        config = LeaderConfig(
            instance=self._instance,
            transfer_port=port,
            period_ns=self._period_ns,
            align_row=self._align_row,
            max_delay_ns=self._max_delay_ns,
            beacons=self._beacons.group,
        )
        self._engine = Leader(config, random.Random(secrets.randbits(64)))
        self._server = TransferServer(ToLeader, Service(self).serve)
        self._pump = Pump(self._engine, self._clock.now_ns, self._drain)
        await self._server.start(listening)
        self._pump.start(datagrams)
        self._spawn(self._keep_house())
        self._spawn(self.revival.begin(self._clock.now_ns(), folders=self._revive, wait_ns=self._return_ns))

    async def stop(self) -> None:
        """Close the port; bursts under way are saved with what has come."""
        self._pump.close()
        self._beacons.close()
        await self._server.stop()
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for burst in self._bursts.values():
            if not burst.finished.is_set():
                # Nodes still have what has not come, and the next start may fetch it.
                await (burst.leave() if burst.is_empty() else burst.stop("the leader was stopped"))
                self._note_finished(burst)
        await self.revival.stop()

    def status(self) -> RigStatus:
        """The whole rig at this moment."""
        now_ns = self._clock.now_ns()
        goal = self._engine.goal
        return RigStatus(
            leader=str(self.address),
            now_ns=now_ns,
            period_ns=None if goal is None else goal.period_ns,
            nodes=node_statuses(self._engine.clients(now_ns)),
            burst=None if self._last_burst is None else self._last_burst.status,
            sessions=tuple(self._saved),
        )

    async def snapshots(self, interval_s: float = SNAPSHOT_EVERY_S) -> AsyncIterator[RigStatus]:
        """Yield the rig's status again and again, for a screen to show."""
        while True:
            yield self.status()
            await asyncio.sleep(interval_s)

    async def trigger(self, *, frames: int, spacing: int = 1, at_leader_ns: int | None = None) -> BurstStatus:
        """Order a burst of all nodes that are here, and begin its session.

        Raises BadInputError for an impossible burst or a folder that cannot be written, NoCameraHereError
        where there is no camera, DiskFullError where it will hardly find room here or on a node.
        """
        if sum(not burst.finished.is_set() for burst in self._bursts.values()) >= MAX_OPEN_BURSTS:
            raise IncompleteError(
                f"{MAX_OPEN_BURSTS} bursts are still being saved", hint="wait until they are there"
            )
        self._engine.check_burst(frames=frames, spacing=spacing)
        image_bytes = expected_image_bytes(self._views(), self._image_bytes)
        check_room(self.sessions, image_bytes, frames, self._spools)
        # A number that was given up is never given again: nodes may still know it.
        writer, number = await asyncio.to_thread(create_numbered, self.sessions, after=self._last_number)
        self._last_number = max(self._last_number, number)
        try:
            burst = self._engine.trigger(
                self._clock.now_ns(),
                frames=frames,
                spacing=spacing,
                at_leader_ns=at_leader_ns,
                number=number,
            )
        except SimulshotError:
            await asyncio.to_thread(writer.discard)
            raise
        session = self._begin(burst, writer)
        # On disk before any node can hear of it, so that whatever is picked can be fetched after a crash.
        try:
            await session.begin(self._instance)
        except SimulshotError as error:
            await session.cancel(error.what)
            raise
        self._pump.turn()
        return session.status

    async def finished(self, burst: int) -> BurstStatus:
        """Wait until a burst is saved or given up, and return its last status."""
        session = self._bursts[burst]
        await session.finished.wait()
        return session.status

    async def wait_until_ready(self, timeout_s: float, *, nodes: int = 1) -> None:
        """Wait until at least that many nodes are here and all of them are ready.

        Raises IncompleteError that names those that are not, when the time is over.
        """
        async for _ in not_ready(self._views, timeout_s, nodes):
            pass

    async def take_burst(self, request: BurstRequest) -> AsyncGenerator[BurstStatus, None]:
        """Wait for the nodes as asked, take a burst, and yield its progress until it is done."""
        if request.wait_ready_s:
            async for reason in not_ready(self._views, request.wait_ready_s, request.nodes):
                yield BurstStatus(
                    burst=0,
                    name="",
                    cameras=0,
                    instants=request.frames,
                    received=0,
                    expected=0,
                    message=f"waiting for the rig: {reason}",
                )
        status = await self.trigger(
            frames=request.frames, spacing=request.spacing, at_leader_ns=request.at_leader_ns
        )
        session = self._bursts[status.burst]
        while not session.finished.is_set():
            yield session.status
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(SNAPSHOT_EVERY_S):
                    await session.finished.wait()
        yield session.status

    async def session_of(self, message: CameraReport | ImageUpload) -> BurstSession:
        """Return the burst of an upload, of this run or of an earlier one whose session lacks it.

        Raises BadInputError where there is no such burst, TryAgainError where its session is in use.
        """
        session = self._bursts.get(message.burst) if message.leader == self._instance else None
        if session is not None and not session.finished.is_set():
            return session
        if isinstance(message, ImageUpload):
            return self.revival.open_session(message)
        return await self.revival.revive(message, self._clock.now_ns())

    def space_told(self, space: NodeSpace) -> None:
        """Note how much room a node has, for the next burst."""
        self._spools[space.camera] = space

    def image_stored(self, session: BurstSession) -> None:
        """Tell how far a burst is; its end is told apart."""
        if not session.finished.is_set():
            self._on_news(session.status)

    def now_ns(self) -> int:
        """Return the rig's time in ns: this leader's clock."""
        return self._clock.now_ns()

    # The parts

    def _views(self) -> tuple[ClientView, ...]:
        return self._engine.clients(self._clock.now_ns())

    def _begin(self, burst: Burst, writer: SessionWriter) -> BurstSession:
        session = BurstSession(burst, {view.name: view.camera for view in self._views()}, writer)
        self._bursts[burst.number] = self._last_burst = session
        self._spawn(self._follow(session))
        return session

    async def _follow(self, session: BurstSession) -> None:
        self._on_news(session.status)
        await session.finished.wait()
        self._note_finished(session)

    def _note_finished(self, session: BurstSession) -> None:
        path = session.status.session
        if path is not None and path not in self._saved:
            self._saved.append(path)
        if path is not None:
            self._image_bytes |= session.image_bytes()
        self._on_news(session.status)

    def _revived(self, session: BurstSession) -> None:
        self._spawn(self._follow(session))

    async def _keep_house(self) -> None:
        while True:
            await asyncio.sleep(HOUSEKEEPING_EVERY_S)
            now_ns = self._clock.now_ns()
            lost = {
                view.name: f"lost: {view.report.message}"
                for view in self._engine.clients(now_ns)
                if view.report.state is NodeState.LOST
            }
            for session in (*self._bursts.values(), *self.revival.sessions()):
                if not session.finished.is_set():
                    await session.give_up_silent(lost, now_ns)

    def _drain(self) -> None:
        self._beacons.send_due(self._engine, self._clock.now_ns())
        while (event := self._engine.next_event()) is not None:
            if isinstance(event, BurstRefused) and event.burst in self._bursts:
                self._spawn(self._bursts[event.burst].give_up(event.name, event.reason))
            self._on_news(event)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
