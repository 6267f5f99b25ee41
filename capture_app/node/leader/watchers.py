"""Streams of operators that watch a rig: its status whenever it changes, its events, and previews."""

import asyncio
import sys

from msgspec.structs import replace

from capture_app.common.address import Address
from capture_app.common.stagger import describe_steps
from capture_app.common.tasks import first_of
from capture_app.net.channel import Channel
from capture_app.node.leader.bursts import ActiveBursts
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.node.leader.readiness import review_rates, rig_advice
from capture_app.node.leader.snapshots import fitted, fitted_burst, node_statuses, page_of
from capture_app.node.leader.viewfinders import Viewfinders
from capture_app.protocol.log import Log
from capture_app.protocol.messages import StatusAnswer, ToLeader
from capture_app.protocol.orders import NO_PREVIEWS, LogAnswer, PreviewRequest, PreviewSeen
from capture_app.protocol.status import RigStatus
from capture_app.sync.rig.leader_engine import Leader
from capture_app.sync.timekeeping.rates import HostOffRate, RateVote

REVIEW_EVERY_NS = 1_000_000_000
"""Interval between checks of the clocks' rates."""
TICK_S = 0.1
"""Minimum interval between two statuses."""
PICTURE_TICK = 0.2
"""Maximum interval between two looks for pictures to send, in intervals of the requested rate."""
UNUSED_NS = 1_800_000_000_000
"""Time without a camera and without an operator after which a rig is not used."""
KEEPALIVE_S = 3.0
"""Maximum interval between two statuses, so that an operator notices a leader that was lost silently."""


class LeaderState:
    """State of the whole rig, as its leader knows it."""

    def __init__(
        self,
        address: Address,
        options: LeaderOptions,
        engine: Leader,
        bursts: ActiveBursts,
        viewfinders: Viewfinders,
        local: LocalNodes | None,
    ) -> None:
        """`address` is where nodes join; `local` are the nodes of this machine, None where it runs none."""
        self._address, self._options, self._engine = address, options, engine
        self._bursts, self._viewfinders, self._local = bursts, viewfinders, local
        self._rates = RateVote()
        self._rates_due_ns: int | None = None
        self._asked_ns = options.clock.now_ns()

    @property
    def is_unused(self) -> bool:
        """Whether no camera has ever joined, and for UNUSED_NS nobody asked for the status."""
        return self._engine.grid is None and self._options.clock.now_ns() - self._asked_ns > UNUSED_NS

    def status(self, after: str | None = None) -> RigStatus:
        """Return the current status; with `after`, only a page of the nodes after that name."""
        self._asked_ns = self._options.clock.now_ns()
        return self._page("", sys.maxsize) if after is None else fitted(lambda n: self._page(after, n))

    def _page(self, after: str, max_nodes: int) -> RigStatus:
        options, engine, bursts = self._options, self._engine, self._bursts
        now_ns = options.clock.now_ns()
        grid, members, stagger = engine.grid, engine.roster.by_name(), engine.current.config.stagger
        page, further, words = page_of(members, after, max_nodes)
        return RigStatus(
            leader=str(self._address),
            is_open=options.trust.is_open,
            advice=rig_advice(members, str(self._address), now_ns, self._rates.off),
            now_ns=now_ns,
            period_ns=None if grid is None else grid.period_ns,
            stagger=str(stagger or ""),
            steps=describe_steps((engine.current.delays_ns or {}).values()) if stagger else "",
            message=words,
            further=further,
            nodes=node_statuses(
                page,
                members,
                now_ns=now_ns,
                health=self._viewfinders.health,
                spools=bursts.spools,
                local={} if self._local is None else self._local.specs,
            ),
            burst=None if bursts.newest is None else fitted_burst(bursts.newest.status),
            unsaved=tuple(
                replace(session.status, message="", transfer=(), skipped=())
                for session in bursts.under_way()
                if session is not bursts.newest
            ),
            ahead=bursts.ahead,
            disk_free_bytes=bursts.free_bytes,
            sessions=tuple(bursts.saved),
            sessions_folder=str(options.sessions.absolute()),
        )

    async def look_at_disk(self) -> None:
        """Read what the next statuses say of the sessions' disk."""
        await self._bursts.look_at_disk()

    def look_at_rates(self, now_ns: int) -> list[HostOffRate]:
        """Check at intervals which clocks run oddly; return changes."""
        if self._rates_due_ns is not None and now_ns < self._rates_due_ns:
            return []
        self._rates_due_ns = now_ns + REVIEW_EVERY_NS
        return review_rates(self._rates, self._engine.roster.by_name())


class Watcher:
    """Sender of a rig's changes to one operator; it costs nothing while no one watches."""

    def __init__(
        self, channel: Channel[ToLeader], rig: LeaderState, log: Log, viewfinders: Viewfinders
    ) -> None:
        self._request = NO_PREVIEWS
        self._unacknowledged: set[str] = set()
        """Cameras whose last preview the operator has not acknowledged yet."""
        self._channel, self._rig, self._event_log, self._viewfinders = channel, rig, log, viewfinders
        self._shown: dict[str, bytes] = {}
        """JPEG shown last of each camera."""

    async def serve(self) -> None:
        """Send changes until the operator closes the stream. Raises NetworkError if they cannot be sent."""
        self._channel.allow_silence()
        try:
            await first_of(self._receive_requests(), self._send_changes(), self._send_pictures())
        finally:
            await self._viewfinders.want(self, None)

    async def _receive_requests(self) -> None:
        while (message := await self._channel.receive_header()) is not None:
            if isinstance(message, PreviewSeen):
                self._unacknowledged.discard(message.camera)
            elif isinstance(message, PreviewRequest):
                self._request = message
                await self._viewfinders.want(self, message)

    async def _send_changes(self) -> None:
        loop = asyncio.get_running_loop()
        sent: RigStatus | None = None
        sent_s, logged_ns = 0.0, 0
        while True:
            began_s = loop.time()
            await self._rig.look_at_disk()
            status = self._rig.status("")
            # Some fields change by themselves: the time, and when nodes were heard.
            nodes = tuple(replace(node, last_seen_ns=0) for node in status.nodes)
            timeless = replace(status, now_ns=0, nodes=nodes)
            if timeless != sent or began_s - sent_s >= KEEPALIVE_S:
                sent, sent_s = timeless, began_s
                await self._channel.send(StatusAnswer(rig=status))
            if lines := self._event_log.after(logged_ns):
                logged_ns = lines[-1].unix_ns
                await self._channel.send(LogAnswer(lines=lines))
            # If a slow link has made this tick long, the next one counts from here.
            await asyncio.sleep(max(TICK_S / 2, began_s + TICK_S - loop.time()))

    async def _send_pictures(self) -> None:
        loop = asyncio.get_running_loop()
        due_s = 0.0
        while True:
            fps = self._request.fps
            await asyncio.sleep(min(TICK_S, PICTURE_TICK / fps) if fps else TICK_S)
            if not fps or self._unacknowledged or loop.time() < due_s:
                continue
            for picture in self._viewfinders.pictures(self._request.cameras):
                if picture.jpeg is not self._shown.get(picture.camera):
                    self._shown[picture.camera] = picture.jpeg
                    self._unacknowledged.add(picture.camera)
                    due_s = loop.time() + 0.9 / fps  # a tick is not exact
                    await self._channel.send(replace(picture, jpeg=b""), picture.jpeg)
