"""Tasks of a node, a relay or a standby that joins: it requests keys, and watches why no leader answers."""

import asyncio
import contextlib
from collections.abc import Sequence

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.net.asking import ask
from capture_app.net.channel import connect
from capture_app.net.local_network import power_saving, power_saving_towards
from capture_app.net.reachability import find_obstacle
from capture_app.net.udp import Pump
from capture_app.node.enrolment import ask_to_enrol
from capture_app.protocol.log import Log
from capture_app.protocol.messages import FromLeader, KeyAnswer, KeyRequest
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.tree.succession import Succession
from capture_app.trust.datagram_keys import LeaderKeys
from capture_app.trust.trust import Trust

KEY_AGAIN_S = 0.3
"""Interval between two requests for a key to one leader, whatever the result of the first."""
LOOK_EVERY_S = 0.25
AGAIN_S = 10.0
UNANSWERED = 2
"""Number of unanswered hellos after which the path to the leaders is examined."""


class Joining:
    """What a process does to join leaders: it requests datagram keys, and logs why no leader answers."""

    def __init__(
        self,
        time: TimeClient,
        keys: LeaderKeys,
        pump: Pump,
        trust: Trust,
        log: Log,
        leaders: Sequence[Address] = (),
        *,
        is_relay: bool = False,
        succession: Succession | None = None,
    ) -> None:
        """`time` is the node's membership; `leaders` are watched while none of them answers.

        A node adopts the machines and names that its leaders vouch for. A machine that may lead itself, by
        `succession`, adopts only those of the leader that it follows, as another standby might only claim to
        lead.
        """
        self._time, self._keys, self._pump, self._trust = time, keys, pump, trust
        self._log, self._leaders, self._succession = log, leaders, succession
        self._request = KeyRequest(name=time.name, instance=time.instance, is_relay=is_relay)
        self._missing = asyncio.Event()
        self._asked: set[tuple[str, int]] = set()

    def look(self, _now_ns: int) -> None:
        """Wake `run` if a datagram key is missing."""
        if self._keys.missing:
            self._missing.set()

    def ask_again(self, leader: tuple[str, int]) -> None:
        """Request another key from a leader, whose answer also has the machines that it knows."""
        if not self._trust.is_open:
            self._keys.missing.add(leader)
            self._missing.set()

    async def run(self) -> None:
        """Request missing keys until cancelled, from all leaders concurrently, and watch the path to them."""
        async with asyncio.TaskGroup() as tasks:
            if self._leaders:
                tasks.create_task(watch_join(self._time, self._leaders, self._log))
            while True:
                for leader in self._keys.missing - self._asked:
                    self._asked.add(leader)
                    tasks.create_task(self._ask(leader))
                self._keys.missing.clear()
                await self._missing.wait()
                self._missing.clear()

    async def _ask(self, leader: tuple[str, int]) -> None:
        try:
            async with await connect(Address(*leader), FromLeader, trust=self._trust) as channel:
                answer = await ask(channel, self._request, KeyAnswer)
            self._keys.hold(leader, answer.grant)
            self._pump.turn()
            if self._succession is None or self._succession.leader == leader:
                await asyncio.to_thread(self._trust.take_trust_of, channel.who, answer.machines, answer.names)
        except SimulshotError as error:
            # Reachability of the leader is checked elsewhere.
            if isinstance(error, UnknownMachineError) or not isinstance(error, NetworkError):
                self._time.note_refusal(str(error))
                with contextlib.suppress(SimulshotError):
                    # This machine's pin may have been added at the leader. A leader with a full disk cannot
                    # store it yet.
                    await ask_to_enrol(Address(*leader), self._trust)
        await asyncio.sleep(KEY_AGAIN_S)
        self._asked.discard(leader)


async def watch_join(time: TimeClient, leaders: Sequence[Address], log: Log) -> None:
    """Log what is in the way to all leaders while none of them answers a node that asks to join.

    It watches until cancelled; `time` is the node's membership.
    """
    said, looked = "", False
    while True:
        if time.is_member:
            said = ""
            if not looked:
                looked = True
                for leader in leaders:
                    if interface := await asyncio.to_thread(power_saving_towards, leader.host):
                        log.say("; ".join(power_saving(interface)))
                        break
        if not _is_unanswered(time):
            await asyncio.sleep(LOOK_EVERY_S)
            continue
        obstacles = await asyncio.gather(*map(find_obstacle, leaders))
        # What a leader has reported itself is already logged.
        sentence = "; ".join(
            str(obstacle) for obstacle in obstacles if obstacle and obstacle.what not in time.why_joining
        )
        if _is_unanswered(time):
            if sentence and sentence != said:
                log.say(sentence)
                said = sentence
            await asyncio.sleep(AGAIN_S if said else LOOK_EVERY_S)


def _is_unanswered(time: TimeClient) -> bool:
    return not time.is_member and time.unanswered >= UNANSWERED
