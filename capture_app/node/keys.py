"""Keys for datagrams: leaders and relays hand them out over streams whose peer they know, nodes ask."""

import asyncio
import contextlib

from capture_app.errors import BadInputError, NetworkError, SimulshotError, UnknownMachineError
from capture_app.net.address import Address
from capture_app.net.channel import connect
from capture_app.net.udp import Pump
from capture_app.node.asking import ask
from capture_app.node.news import NewsLog
from capture_app.node.pairing import ask_to_enrol
from capture_app.node.wire.messages import FromLeader, KeyAnswer, KeyRequest
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.wire.principal import Principal
from capture_app.trust.keys import LeaderKeys
from capture_app.trust.known_machines import Role
from capture_app.trust.sealed_engines import SealedLeader
from capture_app.trust.trust import Peer, Trust

LOOK_EVERY_NS = 1_000_000_000
AGAIN_S = 1.0
"""Between two requests to one leader, whatever came of the first."""


class KeyIssuer:
    """A leader's or a relay's keys: hands them out, takes them back, and tells what was refused."""

    def __init__(self, trust: Trust, sealed: SealedLeader | None, news: NewsLog) -> None:
        """`sealed` is None where datagrams are not sealed."""
        self._trust, self._sealed, self._news = trust, sealed, news
        self._seen_version: int | None = None
        self._due_ns: int | None = None

    def hand_out(self, who: Peer, request: KeyRequest) -> KeyAnswer:
        """Give a key to a node of a machine that may ask for it.

        Raises BadInputError where there is none, UnknownMachineError where that machine was removed since it
        opened its stream.
        """
        if self._sealed is None:
            raise BadInputError("datagrams are not sealed here", hint="this rig is OPEN: it asks nobody")
        machine, role = self._trust.known.find(who.pin), Role.RELAY if request.is_relay else Role.CAMERA
        if who.pin != self._trust.identity.pin and (machine is None or role not in machine.roles):
            raise UnknownMachineError(f"this machine is not known here as {role} any more")
        principal = Principal(request.name, request.instance, who.pin, request.is_relay)
        return KeyAnswer(grant=self._sealed.keys.grant(principal))

    def look(self, now_ns: int) -> None:
        """Do now and then what is due; `now_ns` is the node's own clock."""
        if self._sealed is None or (self._due_ns is not None and now_ns < self._due_ns):
            return
        self._due_ns = now_ns + LOOK_EVERY_NS
        for refused in self._sealed.refusals.take_news(now_ns):
            self._news.note(refused)
        try:
            machines, version = self._trust.known.all(), self._trust.known.version
        except SimulshotError:
            # A damaged file is told of where machines are made known.
            return
        if version != self._seen_version:
            self._seen_version = version
            may_join = {machine.pin for machine in machines if {Role.CAMERA, Role.RELAY} & {*machine.roles}}
            self._sealed.keys.revoke_all_but({self._trust.identity.pin, *may_join})


class KeyRequester:
    """Gets the keys that a node lacks, of each leader that it has something to say to."""

    def __init__(
        self,
        keys: LeaderKeys,
        request: KeyRequest,
        time: TimeClient,
        trust: Trust,
        pump: Pump,
    ) -> None:
        """`time` is the node's membership, which is told where it is not let in."""
        self._keys, self._request, self._time, self._trust = keys, request, time, trust
        self._pump = pump
        self._wanted = asyncio.Event()
        self._asked: set[tuple[str, int]] = set()

    def look(self) -> None:
        """See whether a key is wanted; to be called when there may be news."""
        if self._keys.wanted:
            self._wanted.set()

    async def run(self) -> None:
        """Ask until cancelled; leaders do not wait for each other."""
        async with asyncio.TaskGroup() as tasks:
            while True:
                self.look()
                await self._wanted.wait()
                self._wanted.clear()
                for leader in self._keys.wanted - self._asked:
                    self._asked.add(leader)
                    tasks.create_task(self._ask(leader))
                self._keys.wanted.clear()

    async def _ask(self, leader: tuple[str, int]) -> None:
        try:
            async with await connect(Address(*leader), FromLeader, trust=self._trust) as channel:
                answer = await ask(channel, self._request, KeyAnswer)
            self._keys.hold(leader, answer.grant)
            self._pump.turn()
        except SimulshotError as error:
            # Whether there is a way to a leader at all is looked into elsewhere.
            if isinstance(error, UnknownMachineError) or not isinstance(error, NetworkError):
                self._time.note_refusal(str(error))
                with contextlib.suppress(SimulshotError):
                    # Its pin may have been added there; a leader whose disk is full, say, cannot keep it yet.
                    await ask_to_enrol(Address(*leader), self._trust)
        await asyncio.sleep(AGAIN_S)
        self._asked.discard(leader)
