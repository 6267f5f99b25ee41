"""The leader of a rig: the engine on a socket, the images' server, and the sessions it saves."""

import asyncio
import contextlib
import random
import secrets
from collections.abc import AsyncGenerator, Callable, Sequence
from pathlib import Path
from typing import Self

from msgspec.structs import replace

from capture_app.clock import HostClock, NodeClock
from capture_app.errors import BadInputError
from capture_app.net.address import DEFAULT_PORT, Address, own_machine_address, reachable_host
from capture_app.net.multicast import BeaconSender, send_due_beacon
from capture_app.net.server import TransferServer, bind_port
from capture_app.net.udp import Pump
from capture_app.node.burst.resumed_bursts import RETURN_NS
from capture_app.node.keys import KeyDesk
from capture_app.node.leader.bursts import ActiveBursts, first_instant, frames_and_spacing
from capture_app.node.leader.followers import FollowerNews, RigFollower, SharedGrid
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.node.leader.news import News, NewsLog, TrustNews
from capture_app.node.leader.orders import OperatorOrders
from capture_app.node.leader.readiness import (
    FolderRoom,
    RateReview,
    coarse_nodes,
    reasons_until_ready,
    rig_advice,
)
from capture_app.node.leader.service import LeaderService
from capture_app.node.leader.snapshots import node_statuses
from capture_app.node.leader.viewfinders import Viewfinders
from capture_app.node.leader.watchers import Watchers
from capture_app.node.pairing import PairingDesk, is_node
from capture_app.node.wire.messages import BurstRequest, ToLeader
from capture_app.node.wire.operating import AddCamera
from capture_app.node.wire.pairing import Invited
from capture_app.node.wire.status import BurstStatus, RigStatus
from capture_app.sync.rig.events import BurstRefused
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.rig.roster import ClientView
from capture_app.trust.known_machines import Role
from capture_app.trust.sealed_engines import SealedLeader
from capture_app.trust.trust import Trust

SNAPSHOT_EVERY_S = 0.25


class LeaderNode:
    """A running leader; `async with LeaderNode(...)` binds its port and serves until the block ends."""

    def __init__(
        self,
        *,
        sessions: Path,
        host: str = "0.0.0.0",  # noqa: S104 - cameras are other machines
        port: int = DEFAULT_PORT,
        or_free_port: bool = False,
        period_ns: int | None = None,
        align_row: float | None = None,
        max_delay_ns: int = 0,
        beacons: BeaconSender | None = None,
        clock: NodeClock | None = None,
        on_news: Callable[[News], None] | None = None,
        resume: Sequence[Path] | None = None,
        return_ns: int = RETURN_NS,
        spool: Path | None = None,
        trust: Trust | None = None,
        followers: Sequence[RigFollower] = (),
        grid_phase_ns: int | None = None,
    ) -> None:
        """`resume` are the interrupted sessions to finish, else all; nodes have `return_ns` to come back.

        With `or_free_port` it takes another port where `port` is in use.
        With a `spool` folder for their images, operators may have it run nodes on this machine.
        `trust` is whom it lets in, else its user's.
        `followers` are other programs that are led, too: started and closed here.
        `period_ns`, `grid_phase_ns`, `align_row`, `max_delay_ns` are the engine's, see `LeaderConfig`. With
        `beacons` nodes that hear the same multicast packets agree with each other.
        """
        self.sessions = sessions
        self.address = Address(host, port)
        self._or_free_port = or_free_port
        self._period_ns, self._align_row, self._max_delay_ns = period_ns, align_row, max_delay_ns
        self._beacons, self._followers, self._grid_phase_ns = beacons, followers, grid_phase_ns
        self._trust = trust or Trust.of_user()
        self._clock: NodeClock = clock or HostClock()
        self.news = NewsLog()
        """What has happened, for whoever looks later."""
        self._desk = PairingDesk(self._trust, lambda text: self._on_news(TrustNews(text)))
        self._tell_news = on_news or (lambda _: None)
        self._spool = spool
        self._room = FolderRoom(sessions)
        self._resume = resume
        self._return_ns = return_ns
        self.instance = secrets.randbits(32)
        """This run of the leader, by which nodes tell it from the next."""
        self._engine: Leader
        self._keys: KeyDesk
        self._bursts: ActiveBursts
        self._pump: Pump
        self._server: TransferServer[ToLeader]
        self._viewfinders = Viewfinders()
        self._local: LocalNodes | None = None
        self._orders: OperatorOrders
        self._rates = RateReview()

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    async def start(self) -> None:
        """Bind and serve.

        Raises NetworkError where the port is in use or the host is not this machine's, DiskError or
        BadInputError where this machine's key cannot be had.
        """
        self._trust.server_context()
        for follower in self._followers:
            follower.start(self._clock, self)
        datagrams, listening = bind_port(self.address.host, self.address.port, or_free=self._or_free_port)
        port = listening.getsockname()[1]
        self.own_address = own_machine_address(self.address.host, listening.family, port)
        self.address = Address(reachable_host(self.address.host, listening.family), port)
        config = LeaderConfig(
            instance=self.instance,
            transfer_port=port,
            period_ns=self._period_ns,
            align_row=self._align_row,
            max_delay_ns=self._max_delay_ns,
            grid_phase_ns=self._grid_phase_ns,
            beacons=None if self._beacons is None else self._beacons.group,
        )
        self._engine = Leader(config, random.Random(secrets.randbits(64)))
        sealed = None if self._trust.is_open else SealedLeader(self._engine)
        self._keys = KeyDesk(self._trust, sealed, self._on_news)
        self._bursts = ActiveBursts(
            self.sessions,
            self._engine,
            self._clock.now_ns,
            self._on_news,
            resume=self._resume,
            return_ns=self._return_ns,
        )
        if self._spool is not None:
            self._local = LocalNodes(self.own_address, self._spool, self.news, self.address.host)
        self._orders = OperatorOrders(
            self._engine,
            self._bursts,
            self._local,
            self.news,
            self._clock.now_ns,
            self._drain,
            self._followers,
        )
        watchers = Watchers(self.status, self.news, self._viewfinders)
        service = LeaderService(
            self._bursts,
            self.status,
            self.take_burst,
            self._orders,
            self._viewfinders,
            watchers,
            lambda who, name, instance: is_node(who, self._engine.members.get(name), instance),
            self._desk,
            self._keys,
        )
        self._server = TransferServer(ToLeader, service.serve, trust=self._trust)
        self._pump = Pump(sealed or self._engine, self._clock, self._drain)
        await self._server.start(listening)
        self._pump.start(datagrams)

    async def stop(self) -> None:
        """End the nodes of this machine and close the port; bursts under way are saved with what has come."""
        if self._local is not None:
            await self._local.close()
        for follower in self._followers:
            await follower.close()
        self._pump.close()
        if self._beacons is not None:
            self._beacons.close()
        await self._server.stop()
        await self._bursts.close()

    def status(self) -> RigStatus:
        """The whole rig at this moment."""
        now_ns = self._clock.now_ns()
        goal, views = self._engine.goal, self._engine.clients(now_ns)
        return RigStatus(
            leader=str(self.address),
            is_open=self.is_open,
            advice=rig_advice(views, str(self.address), self._rates.off),
            now_ns=now_ns,
            period_ns=None if goal is None else goal.period_ns,
            nodes=node_statuses(
                views,
                vitals=self._viewfinders.vitals,
                spools=self._bursts.spools,
                local=() if self._local is None else self._local.names,
            ),
            burst=None if self._bursts.newest is None else self._bursts.newest.status,
            ahead=self._bursts.ahead,
            app_phones=tuple(status for follower in self._followers for status in follower.statuses()),
            sessions=tuple(self._bursts.saved),
            sessions_folder=str(self.sessions.absolute()),
            disk_free_bytes=self._room.free_bytes(now_ns),
        )

    @property
    def is_open(self) -> bool:
        """Whether it asks no machine who it is."""
        return self._trust.is_open

    def invite(self, role: Role) -> Invited:
        """Make a code by which one machine becomes known. Raises UnknownMachineError where none needs it."""
        return self._desk.invite(role)

    async def add_camera(self, spec: str) -> str:
        """Run a camera of this machine and return its name. Raises what `LocalNodes.add_camera` raises."""
        (name,) = (await self._orders.carry_out(AddCamera(spec=spec))).names
        return name

    async def wait_until_unwanted(self) -> None:
        """Wait until an operator wants this leader to end."""
        await self._orders.stop_wanted.wait()

    async def trigger(self, *, frames: int) -> BurstStatus:
        """Order a burst of all nodes that are here. Raises what `ActiveBursts.order` raises."""
        session = await self._bursts.order(frames=frames)
        self._pump.turn()
        return session.status

    async def wait_until_saved(self, burst: int) -> BurstStatus:
        """Wait until a burst is saved or given up, and return its last status."""
        return await self._bursts.wait_until_saved(burst)

    async def wait_until_resumed(self) -> None:
        """Wait until the sessions of earlier runs that were taken up at the start are finished."""
        await self._bursts.resumed.wait_until_finished()

    async def wait_until_ready(self, timeout_s: float, *, nodes: int = 1) -> None:
        """Wait until at least that many nodes are here and all of them are ready.

        Raises IncompleteError that names those that are not, when the time is over.
        """
        async for _ in reasons_until_ready(self._views, timeout_s, nodes):
            pass

    async def take_burst(self, request: BurstRequest) -> AsyncGenerator[BurstStatus, None]:
        """Wait for the nodes as asked, take a burst, and yield its progress until it is done."""
        if request.before > (request.frames or 0):
            raise BadInputError(
                f"{request.before} of {request.frames} frames cannot be before", hint="ask for more frames"
            )
        asked_ns = self._clock.now_ns()
        frames = request.frames or 0
        before = BurstStatus(burst=0, name="", cameras=0, instants=frames, received=0, expected=0)
        if self._engine.goal is None:
            told = [answer for follower in self._followers if (answer := follower.take_alone(request))]
            if told:
                yield replace(before, done=True, message="; ".join(told))
                return
        if request.wait_ready_s:
            async for reason in reasons_until_ready(self._views, request.wait_ready_s, request.nodes):
                yield replace(before, message=f"waiting for the rig: {reason}")
            asked_ns = self._clock.now_ns()
        if coarse := coarse_nodes(self._views()):
            yield replace(before, message=f"less accurate than asked for: {coarse}")
        goal = self._engine.goal
        # Without a camera there is no goal: that is said when the burst is ordered.
        frames, spacing = frames_and_spacing(request, goal.period_ns) if goal is not None else (1, 1)
        session = await self._bursts.order(
            frames=frames,
            spacing=spacing,
            spare=request.spare,
            at_leader_ns=first_instant(request, asked_ns, 0 if goal is None else spacing * goal.period_ns),
            name=request.name,
            note=request.note,
            video=request.video,
        )
        self._pump.turn()
        for follower in self._followers:
            follower.take_part(session)
        while not session.finished.is_set():
            yield session.status
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(SNAPSHOT_EVERY_S):
                    await session.finished.wait()
        yield session.status

    def shared_grid(self) -> SharedGrid | None:
        """Return the grid of instants, None before the first camera."""
        return None if self._engine.goal is None else SharedGrid(self._engine.goal)

    def note_follower(self, news: FollowerNews) -> None:
        """Tell what happened to another program that follows."""
        self._on_news(news)

    def _on_news(self, news: News) -> None:
        self.news.note(news)
        self._tell_news(news)

    def _views(self) -> tuple[ClientView, ...]:
        return self._engine.clients(self._clock.now_ns())

    def _drain(self) -> None:
        now_ns = self._clock.now_ns()
        send_due_beacon(self._beacons, self._engine, now_ns, self._keys.seal_for_all)
        self._keys.look(now_ns)
        while (event := self._engine.next_event()) is not None:
            if isinstance(event, BurstRefused):
                self._bursts.note_refusal(event)
            self._on_news(event)
        for news in self._rates.look(self._views, now_ns):
            self._on_news(news)
