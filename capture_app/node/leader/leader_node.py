"""The leader of a rig: its engine on a socket, the server for images, and the sessions it saves."""

import asyncio
import random
import secrets
from socket import socket
from typing import Self

from capture_app.common.errors import SimulshotError
from capture_app.net.server import bind_port
from capture_app.node.endpoint import PortEndpoint
from capture_app.node.leader.bursts import ActiveBursts
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.node.leader.service import LeaderService
from capture_app.node.leader.viewfinders import Viewfinders
from capture_app.node.leader.watchers import LeaderState
from capture_app.protocol.status import RigStatus
from capture_app.sync.rig.events import TriggerAnswered
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.trust.known_machines import CameraNames
from capture_app.trust.sealed_engines import SealedLeader

UNUSED_LOOK_S = 10.0


class LeaderNode(PortEndpoint):
    """A running leader: `async with await LeaderNode.start(options)` serves until the block ends."""

    def __init__(
        self, options: LeaderOptions, engine: Leader, bound: tuple[socket, socket], names: CameraNames | None
    ) -> None:
        """Assemble the parts for a bound port; call `start` instead."""
        super().__init__(options, engine, SealedLeader(engine), bound, self._drain)
        self.options, self.engine, self._names = options, engine, names
        self._storing: asyncio.Task[None] | None = None
        """Task that stores the names."""
        self.bursts = ActiveBursts(options, engine, self.pump)
        self.log.title_of = engine.roster.title
        self._local = (
            None
            if options.spool is None
            else LocalNodes(self.own_address, options.spool, self.log, self.address.host, options.trust)
        )
        viewfinders = Viewfinders()
        self._rig = LeaderState(self.address, options, engine, self.bursts, viewfinders, self._local)
        self.service = LeaderService(
            options, engine, self.pump, self._rig, self.bursts, self._local, viewfinders, self.enrolment
        )

    @classmethod
    async def start(cls, options: LeaderOptions) -> Self:
        """Bind and serve.

        Raises NetworkError where the port is in use or the host is not this machine's, DiskError or
        BadInputError where this machine's key is not available.
        """
        options.trust.server_context()
        names = None if options.trust.folder is None else CameraNames(options.trust.folder)
        bound = bind_port(options.host, options.port, or_free=options.or_free_port)
        continued = options.continued
        engine = Leader(
            LeaderConfig(
                instance=secrets.randbits(32),
                transfer_port=bound[1].getsockname()[1],
                rig=RequestedConfig(
                    period_ns=options.period_ns,
                    align_row=options.align_row,
                    stagger=options.stagger,
                ),
                continues=None if continued is None else continued.upstream_map,
                grid=None if continued is None else continued.grid,
            ),
            random.Random(secrets.randbits(64)),
            owners=None if names is None else names.owners,
        )
        leader = cls(options, engine, bound, names)
        try:
            for follower in options.followers:
                follower.start(options.clock)
        except BaseException:
            await leader.stop()
            raise
        await leader.start_serving(leader.service.serve)
        return leader

    async def stop(self) -> None:
        """Sign off from all nodes, end this machine's nodes and close the port.

        Bursts in progress are saved with the images received so far.
        """
        # Before nodes end, which takes time in which nothing is recorded.
        self.bursts.end_all()
        if self._local is not None:
            await self._local.aclose()
        for follower in self.options.followers:
            await follower.close()
        await super().stop()
        await self.bursts.close()
        if self._storing is not None:
            await self._storing
            await self._store_names()

    def status(self) -> RigStatus:
        """Return the current status of the whole rig."""
        return self._rig.status()

    async def wait_until_unused(self) -> None:
        """Return when no camera has joined, and nobody has looked at the rig for half an hour."""
        while True:
            await asyncio.sleep(UNUSED_LOOK_S)
            if self._rig.is_unused:
                return

    def _drain(self, now_ns: int) -> None:
        while (event := self.engine.next_event()) is not None:
            if isinstance(event, TriggerAnswered):
                self.bursts.note_answer(event)
            else:
                self.service.roster_changed.set()
                if event.change in ("joined", "returned", "forgotten") and (
                    self._storing is None or self._storing.done()
                ):
                    self._storing = asyncio.create_task(self._store_names())
            self.log.note(event)
        for change in self._rig.look_at_rates(now_ns):
            self.log.note(change)

    async def _store_names(self) -> None:
        """Store the names' owners off the event loop, with one write for all changes during the last one."""
        while self._names is not None and not self._names.is_stored:
            try:
                await asyncio.to_thread(self._names.keep)
            except SimulshotError as error:
                self.log.say_of_disk(None, str(error))
                return
