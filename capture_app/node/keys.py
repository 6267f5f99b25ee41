"""Keys for datagrams: leaders and relays hand them out over streams whose peer they know, nodes ask."""

import asyncio
import contextlib
from collections.abc import Callable

from capture_app.errors import BadInputError, NetworkError, UnknownMachineError
from capture_app.net.address import Address
from capture_app.net.channel import connect
from capture_app.node.pairing.introduction import knock
from capture_app.node.wire.messages import FromLeader, KeyAnswer, KeyRequest, Refusal
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.wire.speaker import Speaker
from capture_app.trust.keys import ClientKeys, LeaderKeys
from capture_app.trust.trust import Peer, Trust

AGAIN_S = 1.0
"""Between two requests to one leader, whatever came of the first."""


def hand_out_key(keys: ClientKeys | None, who: Peer, request: KeyRequest) -> KeyAnswer:
    """Give a key to a node of a machine that may ask for it. Raises BadInputError where there is none."""
    if keys is None:
        raise BadInputError("datagrams are not sealed here", hint="start the node with --open, too")
    speaker = Speaker(request.name, request.instance, who.pin, request.is_relay)
    return KeyAnswer(grant=keys.grant(speaker))


class KeyRequester:
    """Gets the keys that a node lacks, of each leader that it has something to say to."""

    def __init__(
        self,
        keys: LeaderKeys,
        request: KeyRequest,
        time: TimeClient,
        trust: Trust,
        after_key: Callable[[], None],
    ) -> None:
        """`time` is the node's membership, which is told where it is not let in."""
        self._keys, self._request, self._time, self._trust = keys, request, time, trust
        self._after_key = after_key
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
            self._keys.hold(leader, (await self._answer(Address(*leader))).grant)
            self._after_key()
        except UnknownMachineError as error:
            self._time.note_refusal(str(error))
            with contextlib.suppress(NetworkError):
                # Its pin may have been added there.
                await knock(Address(*leader), self._trust)
        except NetworkError:
            # Whether there is a way to a leader at all is looked into elsewhere.
            pass
        await asyncio.sleep(AGAIN_S)
        self._asked.discard(leader)

    async def _answer(self, leader: Address) -> KeyAnswer:
        async with await connect(leader, FromLeader, trust=self._trust) as channel:
            await channel.send(self._request)
            answer = await channel.receive_header()
        if isinstance(answer, Refusal):
            raise UnknownMachineError(answer.what, hint=answer.hint)
        if not isinstance(answer, KeyAnswer):
            raise NetworkError(f"{leader} does not hand out keys")
        return answer
