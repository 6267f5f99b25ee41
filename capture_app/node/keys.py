"""Keys for datagrams, as nodes ask for them of each leader that they have something to say to."""

import asyncio
import contextlib

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.net.asking import ask
from capture_app.net.channel import connect
from capture_app.net.udp import Pump
from capture_app.node.pairing import ask_to_enrol
from capture_app.protocol.messages import FromLeader, KeyAnswer, KeyRequest
from capture_app.sync.rig.time_client import TimeClient
from capture_app.trust.keys import LeaderKeys
from capture_app.trust.trust import Trust

AGAIN_S = 0.3
"""Between two requests to one leader, whatever came of the first."""


class KeyRequester:
    """Gets the keys that a node lacks, of each leader that it has something to say to."""

    def __init__(
        self,
        keys: LeaderKeys | None,
        request: KeyRequest,
        time: TimeClient,
        trust: Trust,
        pump: Pump,
    ) -> None:
        """`time` is the node's membership, which is told where it is not let in.

        `keys` is None where datagrams are not sealed: then none is ever wanted.
        """
        self._keys = LeaderKeys() if keys is None else keys
        self._request, self._time, self._trust = request, time, trust
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
            self._trust.take_word(channel.who, answer.machines, answer.names)
        except SimulshotError as error:
            # Whether there is a way to a leader at all is looked into elsewhere.
            if isinstance(error, UnknownMachineError) or not isinstance(error, NetworkError):
                self._time.note_refusal(str(error))
                with contextlib.suppress(SimulshotError):
                    # Its pin may have been added there; a leader whose disk is full, say, cannot keep it yet.
                    await ask_to_enrol(Address(*leader), self._trust)
        await asyncio.sleep(AGAIN_S)
        self._asked.discard(leader)
