"""Requests of a node for datagram keys, one for each leader that it sends to."""

import asyncio
import contextlib
from collections.abc import Callable

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.net.asking import ask
from capture_app.net.channel import connect
from capture_app.net.udp import Pump
from capture_app.node.enrolment import ask_to_enrol
from capture_app.protocol.messages import FromLeader, KeyAnswer, KeyRequest
from capture_app.sync.rig.time_client import TimeClient
from capture_app.trust.datagram_keys import LeaderKeys
from capture_app.trust.trust import Trust

AGAIN_S = 0.3
"""Interval between two requests to one leader, whatever the result of the first."""


class KeyRequester:
    """Fetcher of the datagram keys that a node lacks, from each leader that it sends to."""

    def __init__(
        self,
        keys: LeaderKeys | None,
        request: KeyRequest,
        time: TimeClient,
        trust: Trust,
        pump: Pump,
        trusts: Callable[[Address], bool] = lambda _: True,
    ) -> None:
        """`time` is the node's membership, which is notified of refusals.

        `keys` is None if datagrams are not sealed; then no key is ever requested. `trusts` tells whether to
        adopt the machines and names that a leader vouches for.
        """
        self._keys = LeaderKeys() if keys is None else keys
        self._request, self._time, self._trust = request, time, trust
        self._pump, self._trusts = pump, trusts
        self._missing = asyncio.Event()
        self._asked: set[tuple[str, int]] = set()

    def look(self) -> None:
        """Wake `run` if a datagram key is missing; call it when that may have changed."""
        if self._keys.missing:
            self._missing.set()

    async def run(self) -> None:
        """Request missing keys until cancelled, from all leaders concurrently."""
        async with asyncio.TaskGroup() as tasks:
            while True:
                self.look()
                await self._missing.wait()
                self._missing.clear()
                for leader in self._keys.missing - self._asked:
                    self._asked.add(leader)
                    tasks.create_task(self._ask(leader))
                self._keys.missing.clear()

    async def _ask(self, leader: tuple[str, int]) -> None:
        try:
            async with await connect(Address(*leader), FromLeader, trust=self._trust) as channel:
                answer = await ask(channel, self._request, KeyAnswer)
            self._keys.hold(leader, answer.grant)
            self._pump.turn()
            if self._trusts(Address(*leader)):
                self._trust.take_trust_of(channel.who, answer.machines, answer.names)
        except SimulshotError as error:
            # Reachability of the leader is checked elsewhere.
            if isinstance(error, UnknownMachineError) or not isinstance(error, NetworkError):
                self._time.note_refusal(str(error))
                with contextlib.suppress(SimulshotError):
                    # This machine's pin may have been added at the leader. A leader with a full disk cannot
                    # store it yet.
                    await ask_to_enrol(Address(*leader), self._trust)
        await asyncio.sleep(AGAIN_S)
        self._asked.discard(leader)
